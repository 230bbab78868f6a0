# SPDX-License-Identifier: Apache-2.0
"""A dataset assesses a recording once, again where its result is doubtful, and refuses another result in its place."""

import json
import os
import shutil
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from scara_effmass.analysis.dataset import (
    RECORDS,
    BagResult,
    BagTask,
    Record,
    assess_part,
    remove_unfinished,
    without_copies,
)
from scara_effmass.bags.files import open_bag
from scara_effmass.bags.writer import BagWriter
from scara_effmass.errors import OutputError
from scara_effmass.settings import MonitorSettings
from scara_effmass.share import share

TASK = BagTask(MonitorSettings())
Assess = Callable[..., BagResult]
NO_PROCESS = 1 << 22  # above the largest number of a process


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The first 0.4 s of the reference recording."""
    path = tmp_path_factory.mktemp("recording") / "straight"
    with open_bag(share("bags", "straight_300_200")) as bag, BagWriter(path) as writer:
        for message in bag.messages(stop_ns=bag.start_ns + 400_000_000):
            writer.write(*message)
    return path


@pytest.fixture
def assess(recording: Path, tmp_path: Path) -> Assess:
    """Assess the recording into a dataset in `tmp_path`."""

    def run(task: BagTask = TASK, *, overwrite: bool = False) -> BagResult:
        return assess_part(tmp_path, task, recording, lambda *_: None, cell="A7", overwrite=overwrite)

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
    with pytest.raises(OutputError, match="is of other settings, robot or version"):
        assess(other)
    content = part(tmp_path).read_bytes()
    assess(other, overwrite=True)
    assert part(tmp_path).read_bytes() != content


@pytest.mark.parametrize(("text", "is_damaged"), [("", True), ("{", True), ("{}", False), ('{"key": 1}', False)])
def test_a_result_that_cannot_be_used_is_assessed_again_and_said(
    assess: Assess, tmp_path: Path, text: str, *, is_damaged: bool
) -> None:
    counts = assess().counts
    file = record(tmp_path)
    file.write_text(text)
    if not is_damaged:
        with pytest.raises(OutputError, match=rf"{file}: must be a result of this version: remove it, or use --force"):
            assess()
    again = assess(overwrite=not is_damaged)
    assert again.counts == counts
    assert again.notes == [("assessed again", f"{file}: was damaged, or of another version")]
    assert assess().notes == []


def test_a_renamed_recording_has_one_part(assess: Assess, recording: Path, tmp_path: Path) -> None:
    assess()
    part(tmp_path).write_bytes(b"PAR1")
    renamed = recording.rename(recording.with_name("renamed"))
    try:
        assess_part(tmp_path, TASK, renamed, lambda *_: None, cell="A7", overwrite=False)
    finally:
        renamed.rename(recording)
    assert part(tmp_path).name.startswith("renamed-")


def test_a_recording_of_two_cells_has_two_parts(assess: Assess, recording: Path, tmp_path: Path) -> None:
    first = assess()
    second = assess_part(tmp_path, TASK, recording, lambda *_: None, cell="B", overwrite=True)
    assert second.counts == first.counts
    assert [path.parts[-3] for path in sorted(tmp_path.glob("cell=*/day=*/*.parquet"))] == ["cell=A7", "cell=B"]
    assert len([*tmp_path.glob(f"{RECORDS}/cell=*/*.json")]) == len(("A7", "B"))


def test_the_same_content_counts_once_in_each_cell(recording: Path, tmp_path: Path) -> None:
    paths = [tmp_path / cell / name for cell in ("cell=A", "cell=B") for name in ("x", "y")]
    for path in paths:
        shutil.copytree(recording, path)
    kept, notes = without_copies(paths, None)
    assert kept == paths[::2]
    assert notes == [
        ("counted once", f"{copy}: same content as {path}") for path, copy in zip(kept, paths[1::2], strict=True)
    ]
    assert without_copies(paths, "C")[0] == paths[:1]


def record(folder: Path) -> Path:
    (path,) = folder.glob(f"{RECORDS}/cell=*/*.json")
    return path


def change_record(folder: Path, **changes: Any) -> None:  # noqa: ANN401 - any JSON
    file = record(folder)
    fields = dict(zip(Record._fields, json.loads(file.read_bytes()), strict=True))
    fields |= {name: value for name, value in changes.items() if name in fields}
    fields["result"] |= {name: value for name, value in changes.items() if name not in fields}
    file.write_text(json.dumps([*fields.values()]))


@pytest.mark.parametrize("damage", [b"", b"PAR1", None])
def test_a_damaged_part_is_assessed_again_and_said(assess: Assess, tmp_path: Path, damage: bytes | None) -> None:
    assess()
    content = part(tmp_path).read_bytes()
    part(tmp_path).write_bytes(content[: len(content) // 2] if damage is None else damage)
    subject, text = assess().notes[-1]
    assert subject == "assessed again"
    assert str(part(tmp_path)) in text
    assert part(tmp_path).read_bytes() == content
    assert assess().notes == []


@pytest.mark.parametrize("overwrite", [False, True])
@pytest.mark.parametrize(
    "name", ["../other.parquet", "{outside}", "cell=A7/../../other.parquet", "cell=A7/day=x/{hash}"]
)
def test_a_result_never_names_a_file_of_others(
    assess: Assess, tmp_path: Path, tmp_path_factory: pytest.TempPathFactory, name: str, *, overwrite: bool
) -> None:
    assess()
    outside = tmp_path_factory.mktemp("outside") / f"x-{record(tmp_path).stem}.parquet"
    beside = tmp_path.parent / "other.parquet"
    (tmp_path / "cell=A7" / "day=x").symlink_to(outside.parent)
    for file in (outside, beside):
        file.write_text("mine")
    change_record(tmp_path, key="other", part=name.format(outside=outside, hash=outside.name))
    with nullcontext() if overwrite else pytest.raises(OutputError, match="must be a result of this version"):
        assess(overwrite=overwrite)
    assert outside.read_text() == beside.read_text() == "mine"
    beside.unlink()


def test_what_is_no_file_is_not_replaced_by_a_part(assess: Assess, tmp_path: Path) -> None:
    assess()
    place = part(tmp_path)
    place.unlink()
    os.mkfifo(place)
    with pytest.raises(OutputError, match="must be a file"):
        assess(overwrite=True)
    assert place.is_fifo()


@pytest.mark.parametrize(
    "changes",
    [
        {"counts": {}},
        {"summary": {"timeout_ns": 1, "reasons": {"x": 3}}},
        {"summary": {"timeout_ns": 1, "reasons": {"x …": 1}, "codes": {"x …": 1}, "numbers": {"x …": []}}},
        {"summary": {"timeout_ns": 1, "max_gap_ns": 10**400}},
        {"part": 3},
    ],
)
def test_a_damaged_result_is_refused_in_one_line(assess: Assess, tmp_path: Path, changes: dict[str, Any]) -> None:
    assess()
    change_record(tmp_path, **changes)
    with pytest.raises(OutputError, match="must be a result of this version"):
        assess()


def test_only_unfinished_parts_of_these_recordings_are_removed(tmp_path: Path) -> None:
    day = tmp_path / "cell=A7" / "day=2026-01-01"
    day.mkdir(parents=True)
    unfinished = day / f".run-{16 * 'a'}-{NO_PROCESS}.parquet"
    others = [f".other-{16 * 'a'}-{NO_PROCESS}.parquet", f".run-{16 * 'a'}-{os.getpid()}.parquet"]
    kept = [*(day / name for name in others), day / ".run-a-b.parquet", tmp_path / unfinished.name]
    for file in (unfinished, *kept):
        file.touch()
    remove_unfinished(tmp_path, [Path("bags/run.mcap")])
    assert not unfinished.exists()
    assert all(file.exists() for file in kept)
