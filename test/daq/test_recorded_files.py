"""Force out of CSV and TDMS files, as load cells and NI's programs leave them."""

from __future__ import annotations

import tracemalloc
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from nptdms import ChannelObject, TdmsWriter

from scara_effmass.daq.recorded import RecordedForce
from scara_effmass.daq.source import Unit
from scara_effmass.errors import BagError, EffmassError, SettingsError
from scara_effmass.settings import BagSettings, DaqSettings

if TYPE_CHECKING:
    from collections.abc import Sequence

    from scara_effmass.daq.source import Reading

NS = 10**9
NOW = 1_800_000_000 * NS
CARTS = Path(__file__).parents[1] / "recordings" / "cart_impacts"


def source(path: Path, block_time: float = 0.1, **bag: Any) -> RecordedForce:  # noqa: ANN401 - of any setting
    settings = DaqSettings(block_time=block_time, bag=BagSettings(path=str(path), **{"rate": 0.0} | bag))
    return RecordedForce(settings, lambda: NOW)


def played(recorded: RecordedForce) -> list[Reading]:
    recorded.start()
    readings = []
    while not recorded.ended:
        reading = recorded.read(0.0)
        readings += [] if reading is None else [reading]
    recorded.close()
    return readings


def samples(readings: list[Reading]) -> list[float]:
    return np.concatenate([reading.samples[0] for reading in readings]).tolist() if readings else []


def write(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


def table(header: str, rows: Sequence[tuple[float, float]], delimiter: str = ",") -> str:
    return "\n".join([header, *(f"{time:.6f}{delimiter}{force!r}" for time, force in rows)]) + "\n"


ROWS = [(0.01 * n, 0.5 * n) for n in range(100)]


@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
@pytest.mark.parametrize("name", ["cell.csv", "cell.CSV", "cell.tsv", "cell.txt"])
def test_a_plain_file_is_played_from_now_on(tmp_path: Path, delimiter: str, name: str) -> None:
    path = write(tmp_path / name, table(f"Time (s){delimiter}Force (N)", ROWS, delimiter))
    recorded = source(path)
    readings = played(recorded)
    assert (recorded.unit, recorded.channels, recorded.simulated) == (Unit.NEWTON, ("Force (N)",), False)
    assert recorded.description == f"recorded: {name}, Force (N)"
    assert recorded.sample_rate == pytest.approx(100.0)
    assert samples(readings) == [force for _, force in ROWS]
    assert [(r.first_sample, r.lost, r.stamp_ns) for r in readings] == [
        (10 * n, 0, NOW + n * NS // 10) for n in range(10)
    ]


@pytest.mark.parametrize(
    ("header", "unit", "right", "factor"),
    [
        ("Time (s),Force (N)", "", Unit.NEWTON, 1.0),
        ("t,Force [kN]", "", Unit.NEWTON, 1e3),
        ("time_s,force_n", "", Unit.NEWTON, 1.0),
        ("time_s,bridge_mv", "", Unit.VOLT, 1e-3),
        ("t,Force (lbf)", "", Unit.NEWTON, 4.4482216152605),
        ("time_s,force_lbf", "lbf", Unit.NEWTON, 4.4482216152605),
        ("t,Force (kgf)", "", Unit.NEWTON, 9.80665),
        ("time_s,cell (V)", "V", Unit.VOLT, 1.0),
        ("t,f", "kN", Unit.NEWTON, 1e3),
        ("t,load (left)", "N", Unit.NEWTON, 1.0),
    ],
)
def test_units_are_those_of_the_header_or_the_setting(
    tmp_path: Path, header: str, unit: str, right: Unit, factor: float
) -> None:
    recorded = source(write(tmp_path / "cell.csv", table(header, ROWS)), unit=unit)
    readings = played(recorded)
    assert recorded.unit is right
    assert samples(readings) == [force * factor for _, force in ROWS]


@pytest.mark.parametrize(("unit", "scale"), [("ms", 1e3), ("us", 1e6), ("\u00b5s", 1e6), ("\u03bcs", 1e6)])
def test_times_may_be_in_other_units(tmp_path: Path, unit: str, scale: float) -> None:
    rows = [(time * scale, force) for time, force in ROWS]
    recorded = source(write(tmp_path / "cell.csv", table(f"Time ({unit}),Force (N)", rows)))
    played(recorded)
    assert recorded.sample_rate == pytest.approx(100.0)


def test_absolute_times_stay_and_nanoseconds_keep_all_their_digits(tmp_path: Path) -> None:
    first_ns = 1_700_000_000_123_456_789
    text = "stamp_ns,force_n\n" + "".join(f"{first_ns + n * 78_125},{n}\n" for n in range(2000))
    readings = played(source(write(tmp_path / "cell.csv", text)))
    assert readings[0].stamp_ns == first_ns
    assert readings[0].samples.shape == (1, 1280)


def test_a_long_table_takes_little_more_memory_than_its_numbers(tmp_path: Path) -> None:
    rows = 50_000
    path = write(tmp_path / "cell.csv", "t (s),f (N)\n" + "".join(f"{n / 1000:.3f},{n}\n" for n in range(rows)))
    recorded = source(path)
    tracemalloc.start()
    try:
        recorded.start()
        _, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
        recorded.close()
    assert most < 60 * rows  # 16 for stamp and value, the rest for what grows and for the head


def test_a_date_of_absurd_length_is_refused_in_one_line(tmp_path: Path) -> None:
    path = write(tmp_path / "cell.csv", f"t (ns),f (N)\n{'9' * 5000},1\n")
    with pytest.raises(BagError, match=r"cell.csv: line 2: t \(ns\) = 9+ .*would be right"):
        source(path).start()


def test_comments_blanks_and_missing_rows(tmp_path: Path) -> None:
    rows = [f"{0.01 * n:.2f},{n}" for n in range(200)]
    rows[50:60] = ["0.5,", ",7", "", "0.53", "   ,  ", *[f"{0.01 * n:.2f}," for n in range(55, 60)]]
    path = write(tmp_path / "cell.csv", "# exported\n\nTime (s),Force (N)\n" + "\n".join(rows))
    readings = played(source(path))
    assert samples(readings) == [float(n) for n in range(200) if not 50 <= n < 60]
    assert [(r.first_sample, r.lost) for r in readings if r.lost] == [(60, 10)]


def test_what_is_no_number_comes_as_nan(tmp_path: Path) -> None:
    text = "t (s),f (N)\n0.0,1\n0.1,nan\n0.2,inf\n0.3,2\n"
    assert np.isnan(samples(played(source(write(tmp_path / "cell.csv", text))))).tolist() == [False, True, True, False]


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(("unit", "force"), [("N", "1e308"), ("kN", "-1e307"), ("kN", "1.1e6"), ("N", "-1.1e9")])
def test_what_no_sensor_can_read_comes_as_nan(tmp_path: Path, unit: str, force: str) -> None:
    text = f"t (s),f ({unit})\n0.0,1\n0.1,{force}\n0.2,2\n0.3,2\n"
    assert np.isnan(samples(played(source(write(tmp_path / "cell.csv", text))))).tolist() == [False, True, False, False]


@pytest.mark.parametrize(
    ("text", "bag", "message"),
    [
        ("", {}, "is empty; a header row and rows of numbers would be right"),
        ("\n# note\n", {}, "is empty; a header row"),
        ("force (N)\n1\n", {}, "line 1: has one column; times and force, separated by"),
        ("0.0,1.0\n0.1,2.0\n", {}, "line 1: holds numbers; a header with the names of the columns would be right"),
        ("t,f (N)\n", {}, r"f \(N\): holds 0 samples; at least 2 would be right"),
        ("t,f (N)\n0,1\n", {}, r"f \(N\): holds 1 samples; at least 2 would be right"),
        ("t,f (N)\n0,1\n1,a\n", {}, r"line 3: f \(N\) = 'a' is no number; digits with a decimal point would be right"),
        ("# a\nt,f (N)\n0,1\nx,2\n", {}, "line 4: t = 'x' is no number"),
        ("t;f (N)\n0,5;1,25\n", {}, r"line 2: f \(N\) = '1,25' is no number; digits with a decimal point"),
        ("t,f (N)\n0,1\n1,2\n0.5,3\n", {}, "line 4: t = 0.5 comes after 1; times that rise would be right"),
        ("t,f (N)\nnan,1\n", {}, "line 2: t = nan comes after -inf; times that rise would be right"),
        ("t,f (N)\n1,1\n1,2\n", {}, r"f \(N\): its times do not advance"),
        ("t,f\n0,1\n", {}, "f: does not say its unit; bag.unit = one of N, kN, lbf, kgf, V, mV would be right"),
        ("t,f (oz)\n0,1\n", {}, r"f \(oz\): has the unit 'oz'; convert it to one of N, kN, lbf, kgf, V, mV"),
        ("t,f_lbf\n0,1\n", {"unit": "N"}, "f_lbf: bag.unit = N, but it is in lbf; leave bag.unit empty"),
        ("t,f (kN)\n0,1\n", {"unit": "N"}, r"f \(kN\): bag.unit = N, but it is in kN; leave bag.unit empty"),
        ("t,f (N)\n0,1\n1e308,2\n", {}, "line 3: t = 1e308 is more than 4611686018 s; seconds since 1970 or since the"),
        ("t (ns),f (N)\n-1e19,1\n", {}, r"line 2: t \(ns\) = -1e19 is more than"),
        ("t (h),f (N)\n0,1\n", {}, r"t \(h\) is in h; times in one of s, "),
        ("t,a (N),b (N)\n0,1,2\n", {}, r"bag.topic is empty; one of a \(N\), b \(N\) would be right"),
        ("t,a,b\n0,1,2\n", {"unit": "N"}, "bag.topic is empty; one of a, b would be right"),
        ("t,a (N)\n0,1\n", {"topic": "b"}, r"bag.topic = b: there is no such column; one of t, a \(N\) would be right"),
        ("t,a (N)\n0,1\n", {"time_column": "x"}, "bag.time_column = x: there is no such column; one of t, a"),
        ("t,a (N),a (N)\n0,1,2\n", {"topic": "a (N)"}, "several columns have this name"),
        ("t,a (N)\n0,1\n", {"topic": "t"}, "bag.topic and bag.time_column are both 't'; two columns are needed"),
        ("t\0,f\n", {}, "is no text in UTF-8"),
    ],
)
def test_what_is_wrong_with_a_table_is_said_in_one_line(
    tmp_path: Path, text: str, bag: dict[str, Any], message: str
) -> None:
    path = write(tmp_path / "cell.csv", text)
    with pytest.raises((BagError, SettingsError), match=message) as refusal:
        played(source(path, **bag))
    assert str(refusal.value).startswith(f"{path}: ")
    assert "\n" not in str(refusal.value)


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    for name in ("no.csv", "no.tdms"):
        with pytest.raises(BagError, match=f"{name}: cannot be read: No such file"):
            source(tmp_path / name).start()
        (tmp_path / f"folder_{name}").mkdir()
        with pytest.raises(BagError, match=f"folder_{name}: cannot be read: Is a directory"):
            source(tmp_path / f"folder_{name}").start()
    with pytest.raises(BagError, match=r"text.tdms: cannot be read: "):
        source(write(tmp_path / "text.tdms", "no TDMS at all, but long enough to look at")).start()


@given(text=st.text(st.characters(codec="utf-8"), max_size=60), table_like=st.booleans())
def test_any_text_is_played_or_refused(
    tmp_path_factory: pytest.TempPathFactory, text: str, *, table_like: bool
) -> None:
    path = tmp_path_factory.getbasetemp() / "any.csv"
    path.write_bytes((f"t,f (N)\n{text}" if table_like else text).encode())
    recorded = source(path)
    try:
        played(recorded)
    except EffmassError as error:
        assert "\n" not in str(error)  # noqa: PT017 - most texts are refused, which ones does not matter
    recorded.close()


@pytest.mark.skipif(not CARTS.is_dir(), reason="the recordings are not there")
@pytest.mark.parametrize(("pad", "rate", "count"), [(28, 20.0, 100), (40, 100.0, 500), (52, 100.0, 500)])
@pytest.mark.parametrize("run", [1, 2])
def test_real_runs_of_a_cart_into_a_force_sensor(pad: int, rate: float, count: int, run: int) -> None:
    path = CARTS / f"pad_{pad}mm.csv"
    with pytest.raises(SettingsError, match=r"bag.topic is empty; one of .*Run 1: Force \(N\)"):
        source(path).start()
    recorded = source(path, topic=f"Run {run}: Force (N)", time_column=f"Run {run}: Time (s)")
    readings = played(recorded)
    assert recorded.sample_rate == pytest.approx(rate)
    force = np.array(samples(readings))
    assert len(force) == count
    assert sum(reading.lost for reading in readings) == 0
    assert max(reading.clock_residual for reading in readings) < 1e-9
    assert 3.0 < -force.min() < 11.0  # the sensor reads compression as negative


START = np.datetime64("2024-03-01T12:00:00.000250", "us")
START_NS = int(START.astype("datetime64[ns]").astype(np.int64))
TIMING = {"wf_start_time": START, "wf_increment": 1 / 12_800, "unit_string": "N"}


def tdms(path: Path, channels: dict[str, tuple[np.ndarray, dict[str, Any]]]) -> Path:
    with TdmsWriter(path) as writer:
        writer.write_segment(
            [ChannelObject(*name.split("/"), data, properties) for name, (data, properties) in channels.items()]
        )
    return path


FORCE = np.linspace(-1.0, 200.0, 3000)


def test_a_logged_channel_keeps_its_waveform_times(tmp_path: Path) -> None:
    path = tdms(tmp_path / "run.tdms", {"Untitled/cell": (FORCE, TIMING)})
    recorded = source(path)
    readings = played(recorded)
    assert (recorded.unit, recorded.channels) == (Unit.NEWTON, ("Untitled/cell",))
    assert recorded.sample_rate == pytest.approx(12_800.0)
    assert recorded.description == "recorded: run.tdms, Untitled/cell"
    assert samples(readings) == FORCE.tolist()
    assert [r.stamp_ns for r in readings] == [START_NS, START_NS + NS // 10, START_NS + NS // 5]


@pytest.mark.parametrize(
    ("written", "unit", "right", "factor"),
    [("Volts", "", Unit.VOLT, 1.0), ("mV", "mV", Unit.VOLT, 1e-3), ("", "kN", Unit.NEWTON, 1e3)],
)
def test_units_of_channels(tmp_path: Path, written: str, unit: str, right: Unit, factor: float) -> None:
    properties = TIMING | {"unit_string": written}
    recorded = source(tdms(tmp_path / "run.tdms", {"g/c": (FORCE, properties)}), unit=unit)
    assert samples(played(recorded)) == (FORCE * factor).tolist()
    assert recorded.unit is right


def test_what_is_cut_off_of_a_log_is_said(tmp_path: Path) -> None:
    path = tdms(tmp_path / "run.tdms", {"g/c": (FORCE, TIMING)})
    whole = path.read_bytes()
    for length, losses in ((len(whole), []), (len(whole) - 8000, ["is cut off in its last segment; what"])):
        path.write_bytes(whole[:length])
        recorded = source(path)
        assert samples(played(recorded)) == FORCE[: len(FORCE) - (len(whole) - length) // 8].tolist()
        recorded.start()
        assert [loss.removeprefix(f"{path}: ").partition(" came")[0] for loss in recorded.losses] == losses
        recorded.close()


def test_the_channel_in_a_unit_of_force_is_taken_and_offsets_count(tmp_path: Path) -> None:
    channels: dict[str, Any] = {
        "g/text": (np.array(["a", "b"]), {}),
        "g/temperature": (FORCE, TIMING | {"unit_string": "degC"}),
        "g/cell": (FORCE.astype(np.int16), TIMING | {"wf_start_offset": 0.5}),
    }
    readings = played(source(tdms(tmp_path / "run.tdms", channels)))
    assert readings[0].stamp_ns == START_NS + NS // 2
    assert samples(readings) == FORCE.astype(np.int16).tolist()


def test_a_channel_without_a_date_is_played_from_now_on(tmp_path: Path) -> None:
    properties = {"wf_increment": 0.001, "unit_string": "N"}
    assert played(source(tdms(tmp_path / "run.tdms", {"g/c": (FORCE, properties)})))[0].stamp_ns == NOW


@pytest.mark.parametrize(
    ("channels", "bag", "message"),
    [
        ({"g/c": {"wf_increment": 0.0}}, {}, "g/c: wf_increment = 0.0; the time from sample to sample"),
        ({"g/c": {"wf_increment": 1e300}}, {}, r"g/c: wf_increment = 1e\+300; the time from sample to sample"),
        ({"g/c": {"wf_start_offset": float("inf")}}, {}, "g/c: wf_start_offset = inf; some seconds would be right"),
        ({"g/c": {"wf_increment": "soon"}}, {}, "g/c: wf_increment = 'soon'; a number would be right"),
        (
            {"g/c": {"unit_string": "kip"}},
            {},
            "g/c: has the unit 'kip'; convert it to one of N, kN, lbf, kgf, V, mV, or",
        ),
        ({"g/c": {}}, {"unit": "kN"}, "g/c: bag.unit = kN, but it is in N; leave bag.unit empty"),
        ({"g/a": {}, "g/b": {}}, {}, "bag.topic is empty; one of g/a, g/b would be right"),
        ({"g/a": {}}, {"topic": "g/x"}, "bag.topic = g/x: there is no such channel with numbers; one of g/a would"),
    ],
)
def test_what_is_wrong_with_a_channel_is_said_in_one_line(
    tmp_path: Path, channels: dict[str, dict[str, Any]], bag: dict[str, Any], message: str
) -> None:
    path = tdms(tmp_path / "run.tdms", {name: (FORCE, TIMING | given) for name, given in channels.items()})
    with pytest.raises((BagError, SettingsError), match=message) as refusal:
        source(path, **bag).start()
    assert str(refusal.value).startswith(f"{path}: ")


@pytest.mark.filterwarnings("error")
def test_forces_beyond_all_numbers_of_a_channel_come_as_nan(tmp_path: Path) -> None:
    path = tdms(tmp_path / "run.tdms", {"g/c": (np.array([1.0, 1e307]), TIMING | {"unit_string": "kN"})})
    assert np.isnan(samples(played(source(path)))).tolist() == [False, True]


def test_the_library_adds_nothing_to_what_we_say(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "junk.tdms").write_bytes(b"TDSmxxxx" * 100)
    with pytest.raises(BagError, match=r"junk.tdms: "):
        source(tmp_path / "junk.tdms").start()
    assert capfd.readouterr() == ("", "")


def test_a_file_without_numbers(tmp_path: Path) -> None:
    with pytest.raises(BagError, match=r"run.tdms: holds no channel with numbers"):
        source(tdms(tmp_path / "run.tdms", {"g/text": (np.array(["a", "b"]), {})})).start()
    with pytest.raises(BagError, match=r"g/c: wf_increment = missing; the time from sample to sample"):
        source(tdms(tmp_path / "bare.tdms", {"g/c": (FORCE, {"unit_string": "N"})})).start()
