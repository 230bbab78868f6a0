# SPDX-License-Identifier: Apache-2.0
"""A dataset assesses a recording once, again where its result is doubtful, and refuses another result in its place."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from scara_effmass.analysis.dataset import RECORDS, BagResult, BagTask, assess_part
from scara_effmass.errors import OutputError
from scara_effmass.reference import RobotDynamics
from scara_effmass.settings import MonitorSettings
from scara_effmass.share import share

TASK = BagTask(MonitorSettings())
Assess = Callable[..., BagResult]


@pytest.fixture
def assess(tmp_path: Path, dynamics: RobotDynamics) -> Assess:
    """Assess the reference recording into a dataset in `tmp_path`."""

    def run(task: BagTask = TASK, *, overwrite: bool = False) -> BagResult:
        path = share("bags", "straight_300_200")
        return assess_part(tmp_path, path, "A7", task, dynamics, lambda *_: None, overwrite=overwrite)

    return run


def part(folder: Path) -> Path:
    (path,) = folder.glob("cell=A7/day=*/*.parquet")
    return path


def test_cross_check_assesses_a_recording_again(assess: Assess, tmp_path: Path) -> None:
    first = assess()
    before = part(tmp_path).stat().st_mtime_ns
    assert assess().counts == first.counts
    assert part(tmp_path).stat().st_mtime_ns == before
    assert assess(replace(TASK, cross_check=True)).counts == first.counts
    assert part(tmp_path).stat().st_mtime_ns > before


def test_a_deleted_part_is_assessed_again(assess: Assess, tmp_path: Path) -> None:
    first = assess()
    content = part(tmp_path).read_bytes()
    part(tmp_path).unlink()
    assert assess().counts == first.counts
    assert part(tmp_path).read_bytes() == content


def test_other_settings_replace_a_part_only_with_overwrite(assess: Assess, tmp_path: Path) -> None:
    assess()
    other = BagTask(MonitorSettings(body_regions=("chest",)))
    with pytest.raises(OutputError, match="is of another cell, other settings"):
        assess(other)
    content = part(tmp_path).read_bytes()
    assess(other, overwrite=True)
    assert part(tmp_path).read_bytes() != content


@pytest.mark.parametrize("text", ["", "{}", '{"key": 1}'])
def test_a_result_that_cannot_be_read_is_refused(assess: Assess, tmp_path: Path, text: str) -> None:
    assess()
    (record,) = (tmp_path / RECORDS).iterdir()
    record.write_text(text)
    with pytest.raises(OutputError, match="must be a result of this version"):
        assess(overwrite=True)
