"""`scara-effmass import`: force of files in a new bag."""

import json
from pathlib import Path

import numpy as np
import pytest

from scara_effmass.bags.files import open_bag
from scara_effmass.cli import main
from scara_effmass.errors import BagError
from test.importers.conftest import force_of, imported


@pytest.fixture
def csv(tmp_path: Path) -> Path:
    """Return a CSV file with 3 s of force and one value that is no number."""
    path = tmp_path / "cell.csv"
    rows = [f"{n / 100:.2f},{'nan' if n == 150 else n}" for n in range(300)]
    path.write_text("\n".join(["t (s),f (N)", *rows]), encoding="utf-8")
    return path


def test_bag_holds_the_imported_blocks(csv: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    other = csv.rename(tmp_path / "2 cells.csv")
    assert main(["import", str(other), str(other), "-o", str(tmp_path / "run"), "--frame", "cell", "--invert"]) == 0
    assert capsys.readouterr().out.splitlines() == [
        "/force          2 cells.csv, f (N): 299 samples at 100 Hz, 1 lost, 0 saturated",
        "/force/file1    2 cells.csv, f (N): 299 samples at 100 Hz, 1 lost, 0 saturated",
        f"written         {tmp_path / 'run'}",
    ]
    expected = imported(other, **{"frame_id": "cell", "sensor.invert": True})
    with open_bag(tmp_path / "run") as bag:
        for topic in ("/force", "/force/file1"):
            blocks = list(bag.force_blocks(topic))
            assert force_of(blocks) == force_of(expected)
            for block, right in zip(blocks, expected, strict=True):
                assert np.array_equal(block.saturated_samples, right.saturated_samples)
                marks = right.saturated_samples
                assert block._replace(force=right.force, saturated_samples=marks) == right
        log_times_ns = [message.log_time_ns for message in bag.messages()]
        assert log_times_ns == sorted(log_times_ns)


def test_json_states_what_was_imported(csv: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["import", str(csv), "-o", str(tmp_path / "run.mcap"), "--range", "250", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["output"] == str(tmp_path / "run.mcap")
    (topic,) = result["topics"]
    assert topic["sample_rate_hz"] == pytest.approx(100.0)
    assert topic["last_stamp_s"] == pytest.approx(2.99)
    assert {key: topic[key] for key in ("samples", "lost_samples", "saturated_samples", "losses")} == {
        "samples": 299,
        "lost_samples": 1,
        "saturated_samples": 50,
        "losses": [],
    }


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--topic", "g"], "cell.csv: topic = g: must be one of t (s), f (N)"),
        (["--unit", "kN"], "cell.csv: f (N): unit = kN: must be empty, the file states N"),
        (["--unit", "oz"], "options: unit = 'oz': "),
        (["--sensitivity", "0"], "options: sensor.sensitivity = 0.0: "),
        (["--axis", "w"], "invalid choice: 'w'"),
    ],
)
def test_input_error_is_one_line_and_leaves_nothing(
    csv: Path, tmp_path: Path, options: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    try:
        code = main(["import", str(csv), "-o", str(tmp_path / "run"), *options])
    except SystemExit as ended:
        code = int(ended.code or 0)
    assert code == 2
    output = capsys.readouterr()
    assert output.out == ""
    assert message in output.err
    assert output.err.count("\n") == 1
    assert list(tmp_path.iterdir()) == [csv]


def test_existing_output_is_replaced_only_with_force(
    csv: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["import", str(csv), "-o", str(tmp_path / "run")]
    assert [main(words), main(words), main([*words, "--force"])] == [0, 2, 0]
    assert "exists" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["no.csv", "no.tdms", "no.mcap"])
def test_missing_file_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(BagError, match=f"{name}: (cannot be read: No such file|does not exist)"):
        imported(tmp_path / name)


@pytest.mark.parametrize("name", ["folder.csv", "folder.tdms"])
def test_folder_with_the_suffix_of_a_file_is_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / name).mkdir()
    with pytest.raises(BagError, match=f"{name}: cannot be read: Is a directory"):
        imported(tmp_path / name)
