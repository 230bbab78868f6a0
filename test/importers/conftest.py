# SPDX-License-Identifier: Apache-2.0
"""Import of force files as the tests call it."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from scara_effmass.importers.force import import_force
from scara_effmass.settings import ImportSettings, checked
from scara_effmass.values import ForceBlock

NS = 10**9


def imported(path: Path, **settings: Any) -> list[ForceBlock]:  # noqa: ANN401 - any setting
    return list(import_force(path, checked(ImportSettings, settings, "test"))[1])


def force_of(blocks: Sequence[ForceBlock]) -> list[float]:
    return [float(value) for block in blocks for value in block.force]


def lost_in(blocks: Sequence[ForceBlock]) -> list[tuple[int, int]]:
    """Return the number of the first sample after each gap, and the samples lost in the gap."""
    return [(block.first_sample, block.lost_samples) for block in blocks if block.lost_samples]
