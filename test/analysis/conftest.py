"""A small campaign on the simulated cell, and recordings made wrong from it."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

import pytest

from scara_effmass.analysis.validation import Validation, ValidationSettings, validate
from scara_effmass.bags.files import open_bag
from scara_effmass.bags.writer import BagWriter
from scara_effmass.model.dynamics import RobotDynamics
from scara_effmass.model.load import load_robot
from scara_effmass.settings import MonitorSettings
from scara_effmass.share import share
from scara_effmass.sim.campaign import Campaign, run_campaign
from scara_effmass.values import ForceBlock
from scara_effmass.wire.force import decode_force_block, force_block_message
from scara_effmass.wire.message_types import FORCE_BLOCK, RUN_INFO
from scara_effmass.wire.run_info import decode_run_info, run_info_message

MASSES = (0.5, 7.35)


class Altered(Protocol):
    def __call__(
        self,
        path: Path,
        *,
        block: Callable[[ForceBlock], ForceBlock] | None = None,
        info: dict[str, Any] | None = None,
        without: str = "",
    ) -> Path: ...


@pytest.fixture(scope="session")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Recordings of three configurations, two masses each."""
    folder = tmp_path_factory.mktemp("campaign")
    return [step.path for step in run_campaign(folder, Campaign(obstacle_masses=MASSES, repetitions=1))]


@pytest.fixture(scope="session")
def dynamics() -> RobotDynamics:
    return RobotDynamics(load_robot(share("config", "omron_i4_550l.yaml"), MonitorSettings()))


@pytest.fixture(scope="session")
def validation(campaign: list[Path], dynamics: RobotDynamics) -> Validation:
    return validate(campaign, dynamics, ValidationSettings())


@pytest.fixture
def altered(tmp_path: Path) -> Altered:
    """Copy a recording: force blocks through `block`, run information changed by `info`, one topic left out."""

    def copy(
        path: Path,
        *,
        block: Callable[[ForceBlock], ForceBlock] | None = None,
        info: dict[str, Any] | None = None,
        without: str = "",
    ) -> Path:
        copied = tmp_path / f"altered_{len(list(tmp_path.iterdir()))}"
        with open_bag(path) as bag, BagWriter(copied) as writer:
            for message in bag.messages():
                data = message.data
                if message.topic == without:
                    continue
                if message.type == FORCE_BLOCK and block:
                    data = force_block_message(block(decode_force_block(data)))
                elif message.type == RUN_INFO and info:
                    data = run_info_message(decode_run_info(data)._replace(**info))
                writer.write(message.topic, message.type, message.log_time_ns, data)
        return copied

    return copy
