# SPDX-License-Identifier: Apache-2.0
"""Output files appear complete or not at all."""

import os
from pathlib import Path

import pytest

from scara_effmass.analysis.output import atomic_file, check_output_path
from scara_effmass.errors import OutputError


def test_complete_file_and_its_folders_are_created(tmp_path: Path) -> None:
    path = tmp_path / "a" / "b" / "c.txt"
    with atomic_file(path, overwrite=False) as unfinished:
        unfinished.write_text("whole")
        assert not path.exists()
        assert unfinished.suffix == ".txt"
    assert path.read_text() == "whole"
    assert list(path.parent.iterdir()) == [path]


@pytest.mark.parametrize("error", [ValueError("odd"), KeyboardInterrupt(), SystemExit(143)])
def test_unfinished_file_is_removed(error: BaseException, tmp_path: Path) -> None:
    def write() -> None:
        with atomic_file(tmp_path / "new" / "c.txt", overwrite=False) as unfinished:
            unfinished.write_text("half")
            raise error

    with pytest.raises(type(error)):
        write()
    assert list(tmp_path.iterdir()) == []


def test_interrupt_at_creation_leaves_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(path: Path) -> None:
        path.write_bytes(b"")
        raise KeyboardInterrupt

    monkeypatch.setattr("pathlib.Path.touch", interrupted)
    with pytest.raises(KeyboardInterrupt), atomic_file(tmp_path / "c.txt", overwrite=False):
        pass
    assert list(tmp_path.iterdir()) == []


def test_full_disk_raises_output_error(tmp_path: Path) -> None:
    with (
        pytest.raises(OutputError, match=r"c\.txt: cannot be written: No space left"),
        atomic_file(tmp_path / "c.txt", overwrite=True),
    ):
        raise OSError(28, "No space left on device")
    assert list(tmp_path.iterdir()) == []


def test_existing_file_is_replaced_only_with_overwrite(tmp_path: Path) -> None:
    path = tmp_path / "c.txt"
    path.write_text("existing")
    with pytest.raises(OutputError, match="--force"), atomic_file(path, overwrite=False):
        pass
    assert path.read_text() == "existing"
    with atomic_file(path, overwrite=True) as unfinished:
        unfinished.write_text("new")
    assert path.read_text() == "new"


def test_file_created_meanwhile_is_kept(tmp_path: Path) -> None:
    path = tmp_path / "c.txt"

    def write() -> None:
        with atomic_file(path, overwrite=False) as unfinished:
            unfinished.write_text("mine")
            path.write_text("another's")

    with pytest.raises(OutputError):
        write()
    assert path.read_text() == "another's"
    assert list(tmp_path.iterdir()) == [path]


def test_folder_raises_output_error(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="is a folder"):
        check_output_path(tmp_path, overwrite=True)


def test_device_and_pipe_are_not_replaced(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    for path in (pipe, Path(os.devnull)):
        with pytest.raises(OutputError, match="a device or a pipe"):
            check_output_path(path, overwrite=True)
