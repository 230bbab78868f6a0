# SPDX-License-Identifier: Apache-2.0
"""Import of force from CSV files as programs of load cells write them."""

import os
import tracemalloc
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scara_effmass.errors import BagError, EffmassError, SettingsError
from scara_effmass.importers.force import import_force
from scara_effmass.settings import ImportSettings
from test.importers.conftest import NS, force_of, imported, lost_in

CARTS = Path(__file__).parents[1] / "recordings" / "cart_impacts"
ROWS = [(0.01 * n, 0.5 * n) for n in range(100)]


def write(path: Path, text: str, encoding: str = "utf-8") -> Path:
    path.write_text(text, encoding=encoding)
    return path


def table(header: str, rows: Sequence[tuple[float, float]], delimiter: str = ",") -> str:
    return "\n".join([header, *(f"{time:.6f}{delimiter}{force!r}" for time, force in rows)]) + "\n"


@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
@pytest.mark.parametrize(
    "name", ["cell.csv", "cell.CSV", "cell.tsv", "cell.txt", "cell.asc", "cell.dat", "cell.prn", "cell.log"]
)
def test_plain_file_becomes_blocks_of_100_ms(tmp_path: Path, delimiter: str, name: str) -> None:
    path = write(tmp_path / name, table(f"Time (s){delimiter}Force (N)", ROWS, delimiter))
    blocks = imported(path, frame_id="cell")
    assert force_of(blocks) == [force for _, force in ROWS]
    assert [(b.first_sample, b.lost_samples, b.stamp_ns) for b in blocks] == [
        (10 * n, 0, n * NS // 10) for n in range(10)
    ]
    for block in blocks:
        assert block.sample_rate == pytest.approx(100.0)
        assert (block.source, block.frame_id) == (f"{name}, Force (N)", "cell")
        assert (block.simulated, block.tare, block.tare_stamp_ns, block.relative_uncertainty) == (False, 0.0, 0, 0.0)
        assert not block.force.flags.writeable


@pytest.mark.parametrize(
    ("header", "unit", "newtons"),
    [
        ("Time (s),Force (N)", "", 1.0),
        ("t,Force [kN]", "", 1e3),
        ("time_s,force_n", "", 1.0),
        ("t,Force (lbf)", "", 4.4482216152605),
        ("time_s,force_lbf", "lbf", 4.4482216152605),
        ("t,Force (kgf)", "", 9.80665),
        ("t,f", "kN", 1e3),
        ("t,load (left)", "N", 1.0),
        ("t,Kraft (daN)", "", 10.0),
        ("t,Force [Newton]", "", 1.0),
        ("Time,Force\ns,kN", "", 1e3),
        ("t_s,Force\n[s],[kN]", "", 1e3),
        ("Time (sec),Force (kN)\ns,kN", "", 1e3),
        ("Device,X\nRate,1000\nDate,12.03.2025 14:02:33\n\nTime (s),Force (kN)", "", 1e3),
        ("PRMS,Version 2.1,Hand,1000\nHand\nTime (s),Force (kN)", "", 1e3),
        ("File name:,x.dxd\n\n,Force\nTime (s),kN", "", 1e3),
    ],
)
def test_unit_is_that_of_the_header_or_the_setting(tmp_path: Path, header: str, unit: str, newtons: float) -> None:
    blocks = imported(write(tmp_path / "cell.csv", table(header, ROWS)), unit=unit)
    assert force_of(blocks) == [force * newtons for _, force in ROWS]


@pytest.mark.parametrize(("header", "volts"), [("time_s,bridge_mv", 1e-3), ("time_s,cell (V)", 1.0)])
def test_voltage_is_divided_by_the_sensitivity(tmp_path: Path, header: str, volts: float) -> None:
    path = write(tmp_path / "cell.csv", table(header, ROWS))
    blocks = imported(path, **{"sensor.sensitivity": 20.0, "sensor.invert": True})
    assert force_of(blocks) == pytest.approx([-force * volts / 0.020 for _, force in ROWS])
    assert {block.relative_uncertainty for block in blocks} == {0.15}


@pytest.mark.parametrize(
    ("unit", "scale", "encoding"),
    [
        ("ms", 1e3, "utf-8"),
        ("us", 1e6, "utf-8"),
        ("\u00b5s", 1e6, "utf-8"),
        ("\u03bcs", 1e6, "utf-8-sig"),
        ("\u00b5s", 1e6, "latin-1"),
        ("\u00b5s", 1e6, "utf-16"),
        ("msec", 1e3, "utf-8"),
        ("usec", 1e6, "utf-8"),
        ("Sekunden", 1.0, "utf-8"),
        ("Millisekunden", 1e3, "utf-8"),
    ],
)
@pytest.mark.parametrize("header", ["Time ({}),Prüfling: Force (N)", "Time,Prüfling: Force\n{},N"])
def test_times_may_be_in_other_units(tmp_path: Path, header: str, unit: str, scale: float, encoding: str) -> None:
    rows = [(time * scale, force) for time, force in ROWS]
    blocks = imported(write(tmp_path / "cell.csv", table(header.format(unit), rows), encoding))
    assert blocks[0].sample_rate == pytest.approx(100.0)
    assert blocks[0].source.startswith("cell.csv, Prüfling: Force")


def test_absolute_times_in_nanoseconds_keep_all_digits(tmp_path: Path) -> None:
    first_ns = 1_700_000_000_123_456_789
    text = "stamp_ns,force_n\n" + "".join(f"{first_ns + n * 78_125},{n}\n" for n in range(2000))
    block = imported(write(tmp_path / "cell.csv", text))[0]
    assert (block.stamp_ns, len(block.force)) == (first_ns, 1280)


def test_times_of_19_digits_are_nanoseconds(tmp_path: Path) -> None:
    """`rostopic echo -p` writes them without a unit."""
    rows = "".join(f"{1_700_000_000 * NS + n * 10_000_000},0,{n}\n" for n in range(100))
    path = write(tmp_path / "cell.csv", f"%time,field.header.seq,field.wrench.force.z\n{rows}")
    blocks = imported(path, topic="field.wrench.force.z", unit="N")
    assert blocks[0].stamp_ns == 1_700_000_000 * NS
    assert blocks[0].sample_rate == pytest.approx(100.0)


@pytest.mark.parametrize(
    ("header", "settings"),
    [
        ("secs,nsecs,force_N", {}),
        ("stamp_sec,stamp_nanosec,force_N", {}),
        ("header.stamp.sec,header.stamp.nanosec,force_N", {}),
        ("Seconds,Nanoseconds,force_N", {"time_column": "Seconds"}),
        ("a,b,force_N", {"time_column": "a,b"}),
        ("", {"header": False, "unit": "N", "topic": "2", "time_column": "0,1"}),
    ],
)
def test_seconds_and_nanoseconds_in_two_columns(tmp_path: Path, header: str, settings: dict[str, Any]) -> None:
    first_ns = 1_700_000_000_987_654_321
    stamps = [divmod(first_ns + n * 10_000_000, NS) for n in range(100)]
    rows = [f"{seconds},{rest},{n}" for n, (seconds, rest) in enumerate(stamps)]
    blocks = imported(write(tmp_path / "cell.csv", "\n".join([*filter(None, [header]), *rows])), **settings)
    assert (blocks[0].stamp_ns, lost_in(blocks)) == (first_ns, [])
    assert blocks[0].sample_rate == pytest.approx(100.0)


@pytest.mark.parametrize("header", ["Time,Force (N)", "$TIMER[1],K_F_ext[2] (N)", "Time (ms),Force (N)"])
def test_durations_of_matlab_state_their_unit(tmp_path: Path, header: str) -> None:
    path = write(tmp_path / "cell.csv", header + "\n" + "".join(f"{time:g} sec,{force}\n" for time, force in ROWS))
    blocks = imported(path, topic="1")
    assert blocks[0].sample_rate == pytest.approx(100.0)
    assert force_of(blocks) == [force for _, force in ROWS]


@pytest.mark.parametrize("header", ["Time[0],Y[0]", "t,O_F_ext_hat_K[2]", "t,Force (1)"])
def test_a_number_in_brackets_is_no_unit(tmp_path: Path, header: str) -> None:
    path = write(tmp_path / "cell.csv", table(header, ROWS))
    with pytest.raises(SettingsError, match="states no unit; state --unit"):
        imported(path)
    assert force_of(imported(path, unit="N")) == [force for _, force in ROWS]


def test_long_table_takes_little_more_memory_than_its_numbers(tmp_path: Path) -> None:
    rows = 50_000
    path = write(tmp_path / "cell.csv", "t (s),f (N)\n" + "".join(f"{n / 1000:.3f},{n}\n" for n in range(rows)))
    tracemalloc.start()
    try:
        count = sum(len(block.force) for block in import_force(path, ImportSettings())[1])
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert count == rows
    assert peak < 60 * rows  # bytes; 16 for stamp and value, 8 for the number, and growth


def test_comments_blanks_and_missing_rows_are_skipped(tmp_path: Path) -> None:
    rows = [f"{0.01 * n:.2f},{n}" for n in range(200)]
    rows[50:60] = ["0.5,", ",7", "", "0.53", "   ,  ", *[f"{0.01 * n:.2f}," for n in range(55, 60)]]
    blocks = imported(write(tmp_path / "cell.csv", "# exported\n\nTime (s),Force (N)\n" + "\n".join(rows)))
    assert force_of(blocks) == [float(n) for n in range(200) if not 50 <= n < 60]
    assert lost_in(blocks) == [(60, 10)]


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("unit", "force"),
    [("N", "nan"), ("N", "inf"), ("N", "1e308"), ("kN", "-1e307"), ("kN", "1.1e6"), ("N", "-1.1e9")],
)
def test_value_that_no_sensor_can_measure_is_lost(tmp_path: Path, unit: str, force: str) -> None:
    text = f"t (s),f ({unit})\n0.0,1\n0.1,{force}\n0.2,2\n0.3,3\n"
    blocks = imported(write(tmp_path / "cell.csv", text))
    assert [(b.first_sample, b.lost_samples) for b in blocks] == [(0, 0), (2, 1), (3, 0)]
    assert [b.stamp_ns for b in blocks] == pytest.approx([0, 2 * NS // 10, 3 * NS // 10], abs=1)


def test_samples_at_the_end_of_the_range_are_marked(tmp_path: Path) -> None:
    path = write(tmp_path / "cell.csv", table("t (s),f (N)", [(0.01 * n, f) for n, f in enumerate([1.0, -99.95, 150])]))
    assert [b.saturated_samples.tolist() for b in imported(path, **{"sensor.range": 100.0})] == [[1, 2]]
    assert [b.saturated_samples.tolist() for b in imported(path)] == [[]]


@pytest.mark.parametrize(
    ("text", "settings", "message"),
    [
        ("", {}, "is empty; must have a header row and rows of numbers"),
        ("\n# note\n", {}, "is empty; must have a header row"),
        ("force (N)\n1\n", {}, "line 1: has one column; must have times and force, separated by"),
        ("0.0,1.0\n0.1,2.0\n", {}, "line 1: has numbers; must be a header with the names of the columns"),
        ("t,f (N)\n", {}, r"f \(N\): has 0 samples; must have at least 2"),
        ("t,f (N)\n0,1\n", {}, r"f \(N\): has 1 samples; must have at least 2"),
        ("t,f (N)\n0,1\n1,a\n", {}, r"line 3: f \(N\) = 'a': must be digits with a decimal point"),
        ("# a\nt,f (N)\n0,1\nx,2\n", {}, "line 4: t = 'x': must be digits"),
        ("t;f (N)\n0,5;1.25\n", {}, r"line 2: t = '0,5': must be digits with a decimal point, or one decimal comma"),
        (
            "t;f (N)\n0;976\n1;1.558\n2;1.570\n",
            {},
            r"f \(N\): 3 digits behind every mark, none in 976: must have no th",
        ),
        ("t (s),f (N)\n0,001,0,5\n", {}, "line 2: has 4 fields, the first row 2: must be as many; a decimal comma"),
        ("t,f (N)\n0,1\n1,2\n0.5,3\n", {}, "line 4: t = 0.5: must not be less than 1, the time before"),
        ("t,f (N)\nnan,1\n", {}, "line 2: t = 'nan': must be digits"),
        ("t,f (N)\n1,1\n1,2\n", {}, r"f \(N\): its times do not advance"),
        ("t,f (N)\n0,nan\n1,nan\n", {}, r"f \(N\): has no finite sample"),
        ("t,f (V)\n0,1\n1,2\n", {}, "sensor.sensitivity: must be stated for values in V: --sensitivity MV_PER_N"),
        (
            "t,f (kN)\n0,1\n1,2\n",
            {"sensor.sensitivity": 2.31},
            "sensor.sensitivity = 2.31: must not be stated, the values are in kN",
        ),
        ("t,f\n0,1\n", {}, "f: states no unit; state --unit, one of N, kN, daN, lbf, kgf, V, mV"),
        ("t,f (oz)\n0,1\n", {}, r"f \(oz\): has the unit 'oz'; convert it, or state --unit, one of N, kN, daN, lbf"),
        ("t,f_lbf\n0,1\n", {"unit": "N"}, "f_lbf: unit = N: must be empty, the file states lbf"),
        ("t,f (kN)\n0,1\n", {"unit": "N"}, r"f \(kN\): unit = N: must be empty, the file states kN"),
        ("t,f (N)\n0,1\n1e308,2\n", {}, "line 3: t = 1e308: must be within 2147483647 s of 1970 or of the start"),
        ("t (ns),f (N)\n-1e19,1\n", {}, r"line 2: t \(ns\) = -1e19: must be within"),
        (f"t (ns),f (N)\n{'9' * 5000},1\n", {}, r"line 2: t \(ns\) = 9+ … 9+: must"),
        ("t (h),f (N)\n0,1\n", {}, r"t \(h\): has the unit h; must be one of s, "),
        ("t,Target force (N),Measured (N)\n0,1,2\n", {}, r"must be one of Target force \(N\), Measured \(N\)"),
        ("t,force_cmd_N,sensor_N\n0,1,2\n", {}, "must be one of force_cmd_N, sensor_N"),
        ("t,Soll-Kraft (N),Ist (N)\n0,1,2\n", {}, r"must be one of Soll-Kraft \(N\), Ist \(N\)"),
        ("t,a (N),b (N)\n0,1,2\n", {}, r"topic is empty: must be one of a \(N\), b \(N\)"),
        ("t,a,b\n0,1,2\n", {"unit": "N"}, "topic is empty: must be one of a, b; joint states need --joints FILE"),
        ("t,a (N)\n0,1\n", {"topic": "b"}, r"topic = b: must be one of t, a \(N\)"),
        ("t,a (N)\n0,1\n", {"time_column": "x"}, "time_column = x: must be one of t, a"),
        ("t,a (N),a (N)\n0,1,2\n", {"topic": "a (N)"}, "must be a name that only one column has"),
        ("t,a (N)\n0,1\n", {"topic": "t"}, "topic = time_column = t: must be two columns"),
        ("t\0,f\n", {}, "must be text in UTF-8"),
        ("t,Force,Setpoint (N)\n0,1,2\n", {}, "Force: states no unit; state --unit"),
        ("t,Force,Supply (V)\n0,1,2\n", {}, "Force: states no unit; state --unit"),
        ("t,F,Limit_N\n0,1,2\n", {}, "F: states no unit; state --unit"),
        ("t,Kraft (oz),Excitation (V)\n0,1,2\n", {}, r"Kraft \(oz\): has the unit 'oz'; convert it, or state --unit"),
        ("time_s,sample_n,force\n0,1,2\n", {}, "force: states no unit; state --unit"),
        ("t,Force (N),force_limit (N)\n0,1,2\n", {}, r"empty: must be one of Force \(N\), force_limit \(N\)"),
        ("t,a,Supply (V)\n0,1,2\n", {}, r"topic is empty: must be one of a, Supply \(V\)"),
        ("t,a (N),Supply (V)\n0,1,2\n", {}, r"topic is empty: must be one of a \(N\), Supply \(V\)"),
        ("t,f (N)\n0,1\n0.5,2\n", {"rate": 50.0}, "line 3: rate = 50: must be empty, the file has times: t = 0.5"),
        ("t,f (N)\n0,1\n2,2\n", {"rate": 50.0}, "line 3: rate = 50: must be the rate of the times: t = 2"),
        ("t,f (N)\n0,1\n0,2\n0,3\n", {}, "t: has whole seconds, which several rows share: must be finer; else state"),
        ("t,f (N)\n0,1\n", {"axis": "x"}, "axis = x: must not be stated, a column has no axes"),
        ("f (N)\n0\n1\n", {"rate": 1e-12}, "line 3: rate = 1e-12: must be larger, the file lasts over 2147483647 s"),
        ("0,204\n-0,256\n", {"rate": 1e3, "header": False}, "line 1: is one number with a decimal comma, or two"),
        ("t (s),f (N)\ns,kN\n0,1\n", {}, r"line 2: f \(N\) = kN: must be N, as the header states"),
        ("t,F,on\n0,1,x\nt,F (N),n\n1,2,3\n2,2,3\n", {}, "F: states no unit"),  # a recording above the header
        ("Date,Time,f (N)\n2025-01-01,10:00:00,1\n", {}, "line 2: Date = '2025-01-01': is a date; .* --time-column"),
        (",\n", {}, "line 1: has numbers; must be a header"),
        (
            "Time,f (N)\n1767225600000,1\n",
            {},
            r"line 2: Time = 1767225600000: must be .*: head it with Time",
        ),
        ("time_min,f (N)\n0,1\n", {}, "time_min: has the unit min; must be one of s, sec, ms"),
        ("Time (s),Speed mm/s,Rate N/s\n0,1,2\n", {}, "must be one of Speed mm/s, Rate N/s"),
        ("t,f (N)\n0,1\n1,1_0\n", {}, r"line 3: f \(N\) = '1_0': must be digits"),
        ("secs,nsecs,f (N)\n1,1000000000,1\n", {}, "line 2: secs, nsecs = 1, 1000000000: must be whole seconds, and"),
        ("secs,nsecs,f (N)\n1.5,0,1\n", {}, "line 2: secs, nsecs = 1.5, 0: must be whole seconds, and nanoseconds"),
        ("t,n,f (N)\n1,2,1\n", {"time_column": "t,x"}, "time_column = x: must be one of t, n, f"),
        (
            "t,n,f (N)\n1,2,1\n",
            {"topic": "2", "time_column": "t,2"},
            r"time_column = f \(N\): must be two columns",
        ),
        ("t,f (N)\n3/12/2025 10:00:00,1\n", {}, r"line 2: t = '3/12/2025 .*day and month show in no 3/12/2025"),
        ("sep=:\nt:f (N)\n0:1\n", {}, "line 1: sep = :: must be a comma, a semicolon, a tab or a bar"),
        ("t f (N) p (mm)\n0 1 2\n1 2 3\n2  4\n", {}, "line 4: has 2 fields, the first row 3: must be as many"),
        ("t  p  f_N  2\n0  1  2\n1  2  3\n", {}, "line 1: has one column; must have times and force"),
    ],
)
def test_bad_table_is_refused_in_one_line(tmp_path: Path, text: str, settings: dict[str, Any], message: str) -> None:
    path = write(tmp_path / "cell.csv", text)
    with pytest.raises((BagError, SettingsError), match=message) as refusal:
        imported(path, **settings)
    assert str(refusal.value).startswith(f"{path}: ")
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(("name", "per_s", "start"), [("Time", 1e3, 0.0), ("Date", 1.0 / 86_400.0, 45_992.0)])
def test_times_without_a_unit_that_are_no_seconds_are_refused(
    tmp_path: Path, name: str, per_s: float, start: float
) -> None:
    """Milliseconds, and dates as a spreadsheet counts them."""
    rows = "".join(f"{start + i / 1000.0 * per_s:.15g},{i % 7}\n" for i in range(1000))
    with pytest.raises(BagError, match=f"{name}: states no unit, and in seconds the rate would be .*; must state"):
        imported(write(tmp_path / "cell.csv", f"{name},Force (N)\n{rows}"))
    short = "".join(rows.splitlines(keepends=True)[:12])
    with pytest.raises(BagError, match=f"{name}: states no unit, and in seconds the rate would be"):
        imported(write(tmp_path / "short.csv", f"{name},Force (N)\n{short}"))
    slow = "".join(f"{i},{i % 7}\n" for i in range(1000))
    assert imported(write(tmp_path / "slow.csv", f"{name} (s),Force (N)\n{slow}"))
    daily = "".join(f"2025-01-01T10:{i // 60:02}:{i % 60:02},{i % 7}\n" for i in range(1000))
    assert imported(write(tmp_path / "daily.csv", f"{name},Force (N)\n{daily}"))


@given(text=st.text(st.characters(codec="utf-8"), max_size=60), has_header=st.booleans())
def test_any_text_is_imported_or_refused(
    tmp_path_factory: pytest.TempPathFactory, text: str, *, has_header: bool
) -> None:
    path = tmp_path_factory.getbasetemp() / "any.csv"
    path.write_bytes((f"t,f (N)\n{text}" if has_header else text).encode())
    try:
        imported(path)
    except EffmassError as error:
        assert "\n" not in str(error)  # noqa: PT017 - most texts are refused


@pytest.mark.parametrize(("pad", "rate", "count"), [(28, 20.0, 100), (40, 100.0, 500), (52, 100.0, 500)])
@pytest.mark.parametrize("run", [1, 2])
def test_recording_of_a_cart_on_a_force_sensor(pad: int, rate: float, count: int, run: int) -> None:
    path = CARTS / f"pad_{pad}mm.csv"
    with pytest.raises(SettingsError, match=r"topic is empty: must be one of .*Run 1: Force \(N\)"):
        imported(path)
    blocks = imported(path, topic=f"Run {run}: Force (N)", time_column=f"Run {run}: Time (s)")
    assert blocks[0].sample_rate == pytest.approx(rate)
    assert len(force_of(blocks)) == count
    assert lost_in(blocks) == []
    assert max(block.clock_residual for block in blocks) < 1e-9
    assert 3.0 < -np.min(force_of(blocks)) < 11.0  # the sensor reads compression as negative


@pytest.mark.parametrize("name", ["no.csv", "no.tdms", "no.mcap"])
def test_missing_file_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(BagError, match=f"{name}: (cannot be read: No such file|does not exist)"):
        imported(tmp_path / name)


@pytest.mark.parametrize("name", ["folder.csv", "folder.tdms"])
def test_folder_with_the_suffix_of_a_file_is_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / name).mkdir()
    with pytest.raises(BagError, match=f"{name}: cannot be read: must be a regular file"):
        imported(tmp_path / name)


BLOCKS = {
    "A: Time (s),A: Force (N),B: Time (s),B: Force (N)": ("A: Force (N)", "B: Force (N)"),
    "A: Time (s),B: Time (s),A: Force (N),B: Force (N)": ("A: Force (N)", "B: Force (N)"),
    "Force A (N),Time A (s),Force B (N),Time B (s)": ("Force A (N)", "Force B (N)"),
    "Time (s),Force (N),Time (s).1,Force (N).1": ("Force (N)", "Force (N).1"),
    "t,left (N),time,right (N)": ("left (N)", "right (N)"),
    "no,left (N),time,right (N)": ("right (N)", "right (N)"),
}


@pytest.mark.parametrize("header", BLOCKS)
@pytest.mark.parametrize("block", [0, 1])
def test_times_are_those_of_the_block(tmp_path: Path, header: str, block: int) -> None:
    """Every column of times has a rate of its own: 1000 Hz, 100 Hz, in the order of the columns."""
    names = header.split(",")
    times = [n for n, name in enumerate(names) if name[0] == "t" or "ime" in name]
    periods = dict(zip(times, (0.001, 0.01) if len(times) > 1 else (0.01,), strict=True))
    lines = [",".join(f"{n * periods[i]:.3f}" if i in periods else "1" for i in range(4)) for n in range(100)]
    path = write(tmp_path / "cell.csv", "\n".join([header, *lines]))
    blocks = imported(path, topic=BLOCKS[header][block])
    assert blocks[0].sample_rate == pytest.approx(100.0 if block or len(times) == 1 else 1000.0)


def test_times_that_cannot_be_told_apart_are_refused_with_the_choice(tmp_path: Path) -> None:
    path = write(tmp_path / "cell.csv", "a (N),time,time_s,b (N)\n" + "1,2,3,4\n" * 3)
    with pytest.raises(SettingsError, match=r"time_column is empty: must be that of b \(N\), one of time, time_s"):
        imported(path, topic="b (N)")


@pytest.mark.parametrize("header", ["index,f (N)", "Sample,f (N)", "#no,f (N)"])
def test_a_counter_is_no_time(tmp_path: Path, header: str) -> None:
    path = write(tmp_path / "cell.csv", header.replace("#", "") + "\n" + "".join(f"{n},{n}\n" for n in range(50)))
    with pytest.raises(SettingsError, match="no column has times; state --rate HZ or --time-column"):
        imported(path)
    blocks = imported(path, rate=500.0)
    assert (len(force_of(blocks)), blocks[0].stamp_ns) == (50, 0)
    assert blocks[0].sample_rate == pytest.approx(500.0)


@pytest.mark.parametrize("header", ["X,F,X,F", "x1,y1,x2,y2", "X,F,X.1,F.1"])
def test_each_block_begins_with_a_column_of_times_by_any_name(tmp_path: Path, header: str) -> None:
    rows = [f"{n / 1000},1,{n / 100},2" for n in range(200)]
    path = write(tmp_path / "cell.csv", "\n".join([header, *rows]))
    assert imported(path, topic="1", unit="N")[0].sample_rate == pytest.approx(1000.0)
    assert imported(path, topic="3", unit="N")[0].sample_rate == pytest.approx(100.0)


def test_values_without_times_are_no_times(tmp_path: Path) -> None:
    path = write(tmp_path / "cell.csv", "q1,q2,q3\n0,1,2\n1,2,3\n")
    with pytest.raises(SettingsError, match="no column has times; state --rate HZ or --time-column"):
        imported(path, topic="q3", unit="N")


@pytest.mark.parametrize("mark", [".", ","])
def test_one_column_needs_a_rate(tmp_path: Path, mark: str) -> None:
    path = write(tmp_path / "cell.csv", "Force (N)\n" + "".join(f"{n}{mark}5\n" for n in range(50)))
    with pytest.raises(BagError, match=r"has one column; .*; without times, state --rate HZ"):
        imported(path)
    assert force_of(imported(path, rate=1000.0)) == [n + 0.5 for n in range(50)]


@pytest.mark.parametrize("empty", [",x", ""])
def test_constant_rate_counts_rows_without_a_value_as_lost(tmp_path: Path, empty: str) -> None:
    rows = [f"{n},x" if not 60 <= n < 70 else empty for n in range(300)]
    blocks = imported(write(tmp_path / "cell.csv", "\n".join(["f (N),note", *rows])), rate=1000.0, topic="f (N)")
    assert lost_in(blocks) == [(70, 10)]


@pytest.mark.parametrize("begin", ["10:00:00", "2025-12-31 10:00:00", "36000"])
def test_rate_of_a_file_with_times_in_whole_seconds(tmp_path: Path, begin: str) -> None:
    """Excel writes them; the rate resolves them."""
    rows = [f"{begin[:-1]}{n // 100},{n}" for n in range(250)]
    rows[120:130] = [f"{begin[:-1]}1,"] * 10
    path = write(tmp_path / "cell.csv", "\n".join(["Time,f (N)", *rows]))
    blocks = imported(path, rate=100.0)
    assert blocks[0].stamp_ns % (86_400 * NS) == 36_000 * NS
    assert blocks[0].sample_rate == pytest.approx(100.0)
    assert lost_in(blocks) == [(130, 10)]
    for rate in (40.0, 300.0):
        with pytest.raises(SettingsError, match=f"rate = {rate:g}: must be the rate of the times"):
            imported(path, rate=rate)


@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
def test_file_without_header(tmp_path: Path, delimiter: str) -> None:
    lines = [f"{n / 100:.2f}{delimiter}{n}{delimiter}{-n}" for n in range(100)]
    path = write(tmp_path / "cell.csv", "\n".join(lines))
    blocks = imported(path, header=False, topic="2", unit="N")
    assert force_of(blocks) == [-float(n) for n in range(100)]
    assert blocks[0].source == "cell.csv, 2"
    with pytest.raises(SettingsError, match="topic is empty: must be one of 1, 2"):
        imported(path, header=False, unit="N")
    with pytest.raises(BagError, match="use --no-header"):
        imported(path)


@pytest.mark.parametrize(
    ("header", "row"),
    [
        ("time_s force_N", "{:.18e} {:.18e}"),
        ("  Time (s)     Force (N)  ", "  {:8.3f} {:12.4f} "),
        ("# by numpy.savetxt\n# time_s force_N", "{:.18e} {:.18e}"),
        ("# Time (s),Force (N)", "{},{}"),
        ("time_s\tp\tforce_N", "{}\t\t0\t{}"),
        ("time_s\t\tp\t\tforce_N", "{}\t0\t{}"),
        ("time_s|force_N", "{}|{}"),
        ("| time_s | force_N |", "| {} | {} |"),
        ("Time (s), Force (N)", "{}, {}"),
        ("Date Time Force (N)", "2025-12-31 00:00:{:09.6f} {}"),
    ],
)
def test_columns_between_white_space_or_bars(tmp_path: Path, header: str, row: str) -> None:
    path = write(tmp_path / "cell.txt", "\n".join([header, *(row.format(*pair) for pair in ROWS)]))
    blocks = imported(path, **({"time_column": "Time"} if "Date" in header else {}))
    assert force_of(blocks) == [force for _, force in ROWS]
    assert blocks[0].sample_rate == pytest.approx(100.0)


def test_last_comment_is_no_header_of_other_columns(tmp_path: Path) -> None:
    rows = "".join(f"{time} {force}\n" for time, force in ROWS)
    path = write(tmp_path / "cell.txt", f"# exported today\n{rows}")
    with pytest.raises(BagError, match="line 2: has numbers; must be a header"):
        imported(path)
    assert force_of(imported(path, header=False, unit="N")) == [force for _, force in ROWS]


@pytest.mark.parametrize(
    "header", ["Zeit, s;Kraft, N", "Time (s);Force (N)", "Zeit (s)\tKraft (N)", "sep=;\nTime (s);Force (N)"]
)
def test_decimal_comma(tmp_path: Path, header: str) -> None:
    delimiter = "\t" if "\t" in header else ";"
    lines = [f"{n / 100:.2f}{delimiter}{n / 4}".replace(".", ",") for n in range(100)]
    path = write(tmp_path / "cell.csv", "\n".join([header, *lines]))
    blocks = imported(path, unit="" if "(N)" in header else "N", **({"time_column": "0"} if "Zeit," in header else {}))
    assert force_of(blocks) == [n / 4 for n in range(100)]
    assert blocks[0].sample_rate == pytest.approx(100.0)


@pytest.mark.parametrize(
    ("first", "stamp_ns"),
    [
        ("2025-01-01T10:00:00.{:03d}+01:00", 1_735_722_000 * NS),
        ("2025-01-01 09:00:00,{:03d}Z", 1_735_722_000 * NS),
        ("2025-01-01T09:00:00.{:03d}000000", 1_735_722_000 * NS),
        ("20250101T060000.{:03d}-0300", 1_735_722_000 * NS),
        ("10:00:00.{:03d}", 36_000 * NS),
        ("01.01.2025 09:00:00,{:03d}", 1_735_722_000 * NS),
        ("1.1.2025 9:00:00,{:03d}", 1_735_722_000 * NS),
        ("2025/01/01 09:00:00.{:03d}", 1_735_722_000 * NS),
        ("2025/1/1 9:00:00.{:03d}", 1_735_722_000 * NS),
        ("2025-1-1 9:00:00.{:03d}", 1_735_722_000 * NS),
        ("9:00:00.{:03d}", 32_400 * NS),
        ("9:00:00:{:03d}", 32_400 * NS),
        ("9:00:00.{:03d} AM", 32_400 * NS),
        ("09:00:00,{:03d}pm", 75_600 * NS),
        ("12:00:00.{:03d} a.m.", 0),
        ("12:00:00.{:03d} PM", 43_200 * NS),
        ("01-Jan-2025 09:00:00.{:03d}", 1_735_722_000 * NS),
        ("1-JAN-2025 9:00:00.{:03d} AM", 1_735_722_000 * NS),
    ],
)
def test_times_in_iso_8601(tmp_path: Path, first: str, stamp_ns: int) -> None:
    lines = [f"{first.format(n * 10)};{n}" for n in range(100)]
    blocks = imported(write(tmp_path / "cell.csv", "\n".join(["timestamp;f (N)", *lines])))
    assert blocks[0].stamp_ns == stamp_ns
    assert blocks[0].sample_rate == pytest.approx(100.0)


@pytest.mark.parametrize(
    "header", ["Time / ms,Force / kN", "Time in milliseconds,Force in kilonewtons", "t/ms,F/kN", "Zeit-ms,Kraft {kN}"]
)
def test_units_behind_a_name_without_brackets(tmp_path: Path, header: str) -> None:
    """At 50 kHz, milliseconds could be seconds."""
    rows = "".join(f"{n * 0.02:.2f},{n}\n" for n in range(100))
    blocks = imported(write(tmp_path / "cell.csv", f"{header}\n{rows}"))
    assert blocks[0].sample_rate == pytest.approx(50e3)
    assert force_of(blocks)[:3] == [0.0, 1e3, 2e3]


@pytest.mark.parametrize("day", ["", "2025-12-31 "])
def test_times_of_day_continue_after_midnight(tmp_path: Path, day: str) -> None:
    """A time with a date does not: its day states what follows."""
    lines = [f"{day}{'23:59:59' if n < 50 else '00:00:00'}.{n * 20 % 1000:03d},{n}" for n in range(100)]
    path = write(tmp_path / "cell.csv", "\n".join(["Time,f (N)", *lines]))
    if day:
        with pytest.raises(BagError, match=r"line 52: Time = .* must not be less than"):
            imported(path)
        return
    blocks = imported(path)
    assert (lost_in(blocks), blocks[0].stamp_ns) == ([], 86_399 * NS)
    assert force_of(blocks) == [*range(100)]
    assert blocks[0].sample_rate == pytest.approx(50.0)


def test_infinite_force_is_a_lost_sample(tmp_path: Path) -> None:
    rows = "".join(f"{n / 100},{'inf' if n == 5 else f'{n}.000'}\n" for n in range(10))
    assert lost_in(imported(write(tmp_path / "cell.csv", f"t,f (N)\n{rows}"))) == [(6, 1)]


@pytest.mark.parametrize(
    "text",
    [
        "2025-13-01T10:00:00",
        "2025-01-01T25:00:00",
        "01.13.2025 10:00:00",
        "13:00:00 PM",
        "00:10:00 AM",
        "1-Foo-2025 10:00:00",
    ],
)
def test_time_that_is_no_iso_8601_is_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(BagError, match=r"line 2: t = .*: must be digits .*, or in ISO 8601"):
        imported(write(tmp_path / "cell.csv", f"t;f (N)\n{text};1\n"))


@pytest.mark.parametrize("text", ["x" * 200_000, "a,b\n" + "y" * 5_000_000, '"' + "z" * 200_000 + '",b\n1,2\n'])
def test_long_line_is_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(BagError, match=r"line \d"):
        imported(write(tmp_path / "cell.csv", text))


def test_many_columns_are_no_long_line(tmp_path: Path) -> None:
    names = [f"other {n} (degC)" for n in range(12_000)]
    rows = [",".join([f"{n / 100}", f"{n}", *["0"] * len(names)]) for n in range(3)]
    path = write(tmp_path / "cell.csv", "\n".join([",".join(["t", "f (N)", *names]), *rows]))
    assert force_of(imported(path)) == [0.0, 1.0, 2.0]


def test_pipe_is_refused(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "cell.csv")
    with pytest.raises(BagError, match="must be a regular file"):
        imported(tmp_path / "cell.csv")
