# SPDX-License-Identifier: Apache-2.0
"""A small campaign on the simulated cell, and recordings made wrong from it."""

import hashlib
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path
from typing import Any, Protocol

import pytest

from scara_effmass.analysis.validation import Validation, ValidationSettings, validate
from scara_effmass.bags.files import open_bag
from scara_effmass.bags.writer import BagWriter
from scara_effmass.iso15066 import TABLE_HASH
from scara_effmass.model.load import load_robot
from scara_effmass.reference import RobotDynamics
from scara_effmass.settings import MonitorSettings
from scara_effmass.share import share
from scara_effmass.studies.campaign import Campaign, run_campaign
from scara_effmass.values import ForceBlock
from scara_effmass.wire.force import decode_force_block, force_block_message
from scara_effmass.wire.message_types import FORCE_BLOCK, RUN_INFO
from scara_effmass.wire.run_info import decode_run_info, run_info_message

MASSES = (0.5, 7.35)
ONSET_S = 1_772_614_800
"""Onset of the first contact of `content`, 2026-03-04 9:00 UTC."""
RAW = "\n".join(
    ["Time (s),Force (N)", *(f"{ONSET_S + i / 2000:.4f},{50.0 * (1 <= i % 2000 <= 40)}" for i in range(-40, 6000))]
).encode()
"""Force of the contacts of `content`, one a second."""


class Altered(Protocol):
    def __call__(
        self,
        path: Path,
        *,
        block: Callable[[ForceBlock], ForceBlock] | None = None,
        info: dict[str, Any] | None = None,
        without: str = "",
    ) -> Path: ...


class Page(HTMLParser):
    """What a page holds: tags still open, addresses it names, its texts, pictures and table rows."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.addresses: list[str] = []
        self.texts: list[str] = []
        self.pictures: list[dict[str, str | None]] = []
        self.rows = 0
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.addresses += [value or "" for name, value in attrs if name in {"src", "href", "srcset", "data", "action"}]
        self.rows += tag == "tr"
        if tag == "img":
            self.pictures.append(dict(attrs))
        if tag not in {"meta", "img", "br"}:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if data.strip():
            self.texts.append(data.strip())


@pytest.fixture(scope="session")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Recordings of three configurations, two masses each."""
    folder = tmp_path_factory.mktemp("campaign")
    return [step.path for step in run_campaign(folder, Campaign(obstacle_masses=MASSES, repetitions=1))]


@pytest.fixture(scope="session")
def dynamics() -> RobotDynamics:
    return RobotDynamics(
        load_robot(share("config", "omron_i4_550l.yaml"), MonitorSettings(contact_points=("tool", "elbow")))
    )


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


def contact(number: int, peak_n: float = 100.0) -> dict[str, Any]:
    """Return one contact with the hand, on a device with its stiffness."""
    return {
        "time": f"2026-03-04T10:00:0{number}+01:00",
        "raw_data": "raw.csv",
        "raw_sha256": hashlib.sha256(RAW).hexdigest(),
        "reached_speed_m_s": 0.25,
        "transient_peak_n": peak_n,
        "force_beyond_0_5_s_n": 20.0,
        "duration_s": 0.02,
        "effective_mass_kg": 2.0,
        "reduced_mass_kg": 2.0,
        "predicted_force_n": 1.1 * peak_n,
        "simulated": False,
    }


def content(peak_n: float = 100.0) -> dict[str, Any]:
    """Return a complete protocol of one test, whose contacts have the same peak."""
    return {
        "identity": {
            "robot_model": "arm",
            "robot_serial": "7",
            "firmware": "1.2",
            "safety_checksum": "A1B2",
            "operator": "Tester",
            "test_date": "2026-03-04",
            "standard": "ISO/TS 15066:2016",
            "limits_hash": TABLE_HASH,
        },
        "instruments": [
            {
                "id": "device",
                "model": "gauge",
                "serial": "1",
                "calibration_date": "2025-09-01",
                "calibration_due": "2026-09-01",
                "stiffness_n_m": 75e3,
                "damping": "none",
                "fixed": True,
                "sample_rate_hz": 2000.0,
                "filter": "none",
                "force_uncertainty": 0.03,
                "speed_uncertainty": 0.02,
            }
        ],
        "tests": [
            {
                "id": "1",
                "instrument": "device",
                "point": {
                    "contact_point": "tool",
                    "body_region": "hand_fingers",
                    "contact": "transient",
                    "geometry": "flat",
                    "contact_area_m2": 1e-4,
                    "radius_mm": 5.0,
                },
                "motion": {
                    "pose": {"joint1": 0.5},
                    "direction": [1.0, 0.0, 0.0],
                    "commanded_speed_m_s": 0.25,
                    "payload_kg": 0.0,
                    "safety_setting": "none",
                },
                "results": {
                    "repetitions": [contact(number, peak_n) for number in range(3)],
                    "photos": [],
                    "deviations": "none",
                },
            }
        ],
    }


def changed(value: Any, change: Any) -> Any:  # noqa: ANN401 - parts of a document
    """Return `value`, a part of a document, with the parts in `change` replaced."""
    if isinstance(change, dict):
        return {**(value or {}), **{key: changed((value or {}).get(key), part) for key, part in change.items()}}
    if isinstance(change, list):
        return [changed(*pair) for pair in zip(value, change, strict=False)] + value[len(change) :]
    return change
