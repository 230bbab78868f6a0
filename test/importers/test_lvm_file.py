# SPDX-License-Identifier: Apache-2.0
"""Import of force from LabVIEW measurement files."""

import sys
from pathlib import Path

import pytest

from scara_effmass.errors import BagError, SettingsError
from scara_effmass.extras import missing_extra
from scara_effmass.importers.force import import_force
from scara_effmass.settings import ImportSettings
from test.importers.conftest import NS, force_of, imported, lost_in

HEAD = """LabVIEW Measurement
Writer_Version	2
Reader_Version	2
Separator	Tab
Decimal_Separator	{mark}
X_Columns	{columns}
Time_Pref	Absolute
Date	2025/01/01
Time	09:00:00{mark}25
***End_of_Header***

"""
SEGMENT = """Channels	2
Samples	3	3
Date	2025/01/01	2025/01/01
Time	09:00:0{second}{mark}25	09:00:0{second}{mark}25
Y_Unit_Label	Newtons	Celsius
X0	0	0
Delta_X	0{mark}01	0{mark}01
***End_of_Header***
X_Value	Force	Bridge	Comment
{rows}
"""


def text(mark: str = ".", columns: str = "No", seconds: tuple[int, ...] = (0,)) -> str:
    segments = []
    for second in seconds:
        x = [f"{n / 100:.2f}" if columns == "One" else "" for n in range(3)]
        rows = "\n".join(f"{x[n]}\t{n}.5\t{-n}.5" for n in range(3)).replace(".", mark)
        segments.append(SEGMENT.format(mark=mark, second=second, rows=rows))
    return HEAD.format(mark=mark, columns=columns) + "\n".join(segments)


def write(path: Path, content: str) -> Path:
    path.write_text(content, encoding="utf-8")
    return path


def test_missing_library_is_named_with_its_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "lvm_read", None)
    monkeypatch.delitem(sys.modules, "scara_effmass.importers.lvm_file", raising=False)
    with pytest.raises(ModuleNotFoundError) as error:
        imported(write(tmp_path / "a.lvm", text()))
    assert missing_extra(error.value) == "lvm_read: must be installed: pip install 'scara_effmass[daq]'"


class TestFile:
    @pytest.mark.parametrize("mark", [".", ","])
    @pytest.mark.parametrize("columns", ["No", "One"])
    def test_times_unit_and_values(self, tmp_path: Path, mark: str, columns: str) -> None:
        path = write(tmp_path / "a.lvm", text(mark, columns))
        (block,) = imported(path)
        assert force_of([block]) == [0.5, 1.5, 2.5]
        assert block.sample_rate == pytest.approx(100.0)
        assert (block.stamp_ns, block.source) == (1_735_722_000 * NS + NS // 4, "a.lvm, Force")
        assert len(force_of(imported(path, topic="Bridge", unit="N"))) == 3
        assert list(tmp_path.iterdir()) == [path]  # no pickle

    def test_a_restart_is_a_gap(self, tmp_path: Path) -> None:
        path = write(tmp_path / "a.lvm", text(seconds=(0,)))
        assert lost_in(imported(path)) == []
        with pytest.raises(BagError, match="must have times that advance"):
            imported(write(path, text(seconds=(5, 0))))

    def test_a_file_without_times_needs_a_rate(self, tmp_path: Path) -> None:
        path = write(tmp_path / "a.lvm", text().replace("0.01", "0"))
        with pytest.raises(BagError, match=r"Force: Delta_X = 0: must be .*; without times, state --rate HZ"):
            imported(path)
        assert [(b.sample_rate, force_of([b])) for b in imported(path, rate=50.0)] == [(50.0, [0.5, 1.5, 2.5])]
        for columns in ("No", "One"):
            with pytest.raises(SettingsError, match="Force: rate = 50: must be empty, the file has times"):
                imported(write(path, text(columns=columns)), rate=50.0)

    @pytest.mark.parametrize("columns", ["No", "One"])
    def test_times_in_another_unit(self, tmp_path: Path, columns: str) -> None:
        content = text(columns=columns).replace("X0", "X_Unit_Label\tms\tms\nX0")
        assert imported(write(tmp_path / "a.lvm", content))[0].sample_rate == pytest.approx(1e5)
        with pytest.raises(BagError, match="Force: X_Unit_Label = Hz: must be one of s, sec, ms"):
            imported(write(tmp_path / "a.lvm", content.replace("ms", "Hz")))
        content = text(columns=columns).replace("X0", "X_Dimension\tFrequency\tFrequency\nX0")
        with pytest.raises(BagError, match="Force: X_Dimension = Frequency: must be Time"):
            imported(write(tmp_path / "a.lvm", content))

    def test_times_without_a_unit_that_are_no_seconds_are_refused(self, tmp_path: Path) -> None:
        content = text().replace("0.01", "1.0") + "1.0\t1.0\n" * 100
        with pytest.raises(BagError, match="Force: the X axis: states no unit, and in seconds the rate would be 1 Hz"):
            imported(write(tmp_path / "a.lvm", content))

    @pytest.mark.parametrize("date", ["12/31/2025", "03/04/2025"])
    def test_date_with_the_month_first_is_refused(self, tmp_path: Path, date: str) -> None:
        with pytest.raises(BagError, match=f"Date = {date}, Time = .*: must be as 2025/12/31 and"):
            imported(write(tmp_path / "a.lvm", text().replace("2025/01/01", date)))

    def test_a_pickle_beside_it_is_not_read(self, tmp_path: Path) -> None:
        (tmp_path / "a.lvm.pkl").write_bytes(b"cos\nsystem\n(S'touch /tmp/never'\ntR.")
        assert len(force_of(imported(write(tmp_path / "a.lvm", text())))) == 3

    @pytest.mark.parametrize("columns", ["No", "One"])
    @pytest.mark.parametrize("seconds", [(0,), (0, 1)])
    def test_samples_that_are_missing_at_the_end_are_a_loss(
        self, tmp_path: Path, columns: str, seconds: tuple[int, ...]
    ) -> None:
        content = text(columns=columns, seconds=seconds)
        path = write(tmp_path / "a.lvm", content)
        assert import_force(path, ImportSettings())[0].losses() == ()
        write(path, "\n".join(content.splitlines()[:-1]))
        (loss,) = import_force(path, ImportSettings())[0].losses()
        stated = 3 * len(seconds)
        assert loss == f"{path}: has {stated - 1} of the {stated} samples that it states; the rest is lost"

    def test_channels_that_the_columns_do_not_hold_are_no_silent_loss(self, tmp_path: Path) -> None:
        with pytest.raises(BagError, match="2 of its 3 channels are in columns"):
            imported(write(tmp_path / "a.lvm", text().replace("Channels\t2", "Channels\t3")))

    @pytest.mark.parametrize("content", ["", "LabVIEW Measurement\n", text().replace("Delta_X", "No"), text()[:300]])
    def test_damaged_file_is_refused_in_one_line(self, tmp_path: Path, content: str) -> None:
        with pytest.raises((BagError, SettingsError)) as error:
            imported(write(tmp_path / "a.lvm", content))
        assert "\n" not in str(error.value)
