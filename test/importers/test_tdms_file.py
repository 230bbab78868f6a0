# SPDX-License-Identifier: Apache-2.0
"""Import of force from TDMS files of LabVIEW and NI-DAQmx."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from nptdms import ChannelObject, TdmsWriter

from scara_effmass.errors import BagError, SettingsError
from scara_effmass.importers.force import import_force
from scara_effmass.settings import ImportSettings
from test.importers.conftest import NS, force_of, imported, lost_in

START = np.datetime64("2024-03-01T12:00:00.000250", "us")
START_NS = int(START.astype("datetime64[ns]").astype(np.int64))
TIMING = {"wf_start_time": START, "wf_increment": 1 / 12_800, "unit_string": "N"}
SCALED = {
    "NI_Number_Of_Scales": 1,
    "NI_Scale[0]_Scale_Type": "Linear",
    "NI_Scale[0]_Linear_Slope": 0.01,
    "NI_Scale[0]_Linear_Y_Intercept": 0.0,
    "NI_Scale[0]_Linear_Input_Source": 0,
}
"""A scale whose input is its own output."""
FORCE = np.linspace(-1.0, 200.0, 3000)


def write(path: Path, channels: dict[str, tuple[np.ndarray, dict[str, Any]]]) -> Path:
    with TdmsWriter(path) as writer:
        writer.write_segment(
            [ChannelObject(*name.split("/"), data, properties) for name, (data, properties) in channels.items()]
        )
    return path


def test_channel_keeps_its_waveform_times(tmp_path: Path) -> None:
    blocks = imported(write(tmp_path / "run.tdms", {"Untitled/cell": (FORCE, TIMING)}))
    assert force_of(blocks) == FORCE.tolist()
    assert [b.stamp_ns for b in blocks] == [START_NS, START_NS + NS // 10, START_NS + NS // 5]
    assert {(b.source, b.sample_rate, b.clock_residual) for b in blocks} == {("run.tdms, Untitled/cell", 12_800.0, 0.0)}


@pytest.mark.parametrize(
    ("stated", "settings", "newtons"),
    [
        ("Volts", {"sensor.sensitivity": 2.31}, 1e3 / 2.31),
        ("mV", {"unit": "mV", "sensor.sensitivity": 2.31}, 1.0 / 2.31),
        ("", {"unit": "kN"}, 1e3),
        ("Kilonewtons", {}, 1e3),
    ],
)
def test_unit_is_that_of_the_channel_or_the_setting(
    tmp_path: Path, stated: str, settings: dict[str, Any], newtons: float
) -> None:
    path = write(tmp_path / "run.tdms", {"g/c": (FORCE, TIMING | {"unit_string": stated})})
    force = force_of(imported(path, **settings))
    assert force == pytest.approx((FORCE * newtons).tolist())


def test_cut_file_is_imported_up_to_the_cut(tmp_path: Path) -> None:
    path = write(tmp_path / "run.tdms", {"g/c": (FORCE, TIMING)})
    whole = path.read_bytes()
    for cut, losses in ((0, ()), (8000, (f"{path}: is cut off in its last segment; the rest is lost",))):
        path.write_bytes(whole[: len(whole) - cut])
        file, blocks = import_force(path, ImportSettings())
        assert force_of(list(blocks)) == FORCE[: len(FORCE) - cut // 8].tolist()
        assert file.losses() == losses


def test_channel_with_a_unit_of_force_is_selected_and_offsets_count(tmp_path: Path) -> None:
    channels: dict[str, Any] = {
        "g/text": (np.array(["a", "b"]), {}),
        "g/temperature": (FORCE, TIMING | {"unit_string": "degC"}),
        "g/cell": (FORCE.astype(np.int16), TIMING | {"wf_start_offset": 0.5}),
    }
    blocks = imported(write(tmp_path / "run.tdms", channels))
    assert blocks[0].stamp_ns == START_NS + NS // 2
    assert force_of(blocks) == FORCE.astype(np.int16).tolist()


def test_channel_without_a_date_has_relative_stamps(tmp_path: Path) -> None:
    path = write(tmp_path / "run.tdms", {"g/c": (FORCE, {"wf_increment": 0.001, "unit_string": "N"})})
    assert imported(path)[0].stamp_ns == 0


@pytest.mark.filterwarnings("error")
def test_values_that_are_not_finite_are_lost(tmp_path: Path) -> None:
    signalling = np.uint64(0x7FF0_0000_0000_0001).view(np.float64)
    values = np.array([np.nan, 1.0, 1e307, -np.inf, 2.0, signalling])
    blocks = imported(write(tmp_path / "run.tdms", {"g/c": (values, TIMING | {"unit_string": "kN"})}))
    assert force_of(blocks) == [1e3, 2e3]
    assert lost_in(blocks) == [(1, 1), (4, 2)]
    assert blocks[1].stamp_ns == START_NS + round(4 / 12_800 * NS)


def test_values_that_are_not_finite_at_the_ends_are_a_loss(tmp_path: Path) -> None:
    values = np.array([np.nan, 1.0, np.nan, 2.0, np.inf, np.nan])
    path = write(tmp_path / "run.tdms", {"g/c": (values, TIMING | {"unit_string": "N"})})
    file, blocks = import_force(path, ImportSettings())
    assert force_of(list(blocks)) == [1.0, 2.0]
    assert file.losses() == (f"{path}: the first 1 and the last 2 samples are no numbers",)
    whole, blocks = import_force(write(path, {"g/c": (values[3:4].repeat(3), TIMING)}), ImportSettings(unit="N"))
    assert (len(list(blocks)), whole.losses()) == (1, ())


@pytest.mark.parametrize(
    ("channels", "settings", "message"),
    [
        ({"g/c": {"wf_increment": 0.0}}, {}, r"g/c: wf_increment = 0.0: must be the sampling period \[s\]"),
        ({"g/c": {"wf_increment": 1e300}}, {}, r"g/c: wf_increment = 1e\+300: must be the sampling period"),
        ({"g/c": {"wf_start_offset": float("inf")}}, {}, "g/c: wf_start_offset = inf: must be less than"),
        ({"g/c": {"wf_xunit_string": "Hz"}}, {}, "g/c: wf_xunit_string = Hz: must be one of s, sec, ms"),
        ({"g/c": {"wf_increment": "soon"}}, {}, "g/c: wf_increment = 'soon': must be a number"),
        (
            {"g/c": {"wf_start_time": np.datetime64("1900-01-01", "us")}},
            {},
            "g/c: wf_start_time = 1900-01-01T00.*: must be",
        ),
        (
            {"g/c": {"wf_start_time": np.datetime64("2040-01-01", "us")}},
            {},
            "g/c: wf_start_time = 2040-01-01T00.*: must be",
        ),
        ({"g/c": {"unit_string": "kip"}}, {}, "g/c: has the unit 'kip'; convert it, or state --unit, one of N, kN"),
        ({"g/Kraft": {"unit_string": "kip"}, "g/b": {"unit_string": "V"}}, {}, "g/Kraft: has the unit 'kip'"),
        ({"g/c": {}}, {"header": False}, "header = False: must not be stated"),
        ({"g/c": {"wf_increment": 0.0}}, {"rate": 1e-12}, "rate = 1e-12: must be larger, the file lasts over"),
        ({"g/c": SCALED}, {}, "cannot be read: maximum recursion depth exceeded"),
        ({"g/c": {}}, {"unit": "kN"}, "g/c: unit = kN: must be empty, the file states N"),
        ({"g/a": {}, "g/b": {}}, {}, "topic is empty: must be one of g/a, g/b"),
        ({"g/a": {}}, {"topic": "g/x"}, "topic = g/x: must be one of g/a"),
    ],
)
def test_bad_channel_is_refused_in_one_line(
    tmp_path: Path, channels: dict[str, dict[str, Any]], settings: dict[str, Any], message: str
) -> None:
    path = write(tmp_path / "run.tdms", {name: (FORCE, TIMING | changes) for name, changes in channels.items()})
    with pytest.raises((BagError, SettingsError), match=message) as refusal:
        imported(path, **settings)
    assert str(refusal.value).startswith(f"{path}: ")


def test_file_without_force_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BagError, match=r"run.tdms: has no channel with numbers"):
        imported(write(tmp_path / "run.tdms", {"g/text": (np.array(["a", "b"]), {})}))
    with pytest.raises(BagError, match=r"g/c: wf_increment = missing: must be the sampling period"):
        imported(write(tmp_path / "bare.tdms", {"g/c": (FORCE, {"unit_string": "N"})}))


def test_damaged_file_is_refused_without_other_output(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "junk.tdms").write_bytes(b"TDSmxxxx" * 100)
    (tmp_path / "text.tdms").write_text("no TDMS at all, but long enough to look at", encoding="utf-8")
    for name, problem in (("junk.tdms", "has no channel with numbers"), ("text.tdms", "cannot be read: ")):
        with pytest.raises(BagError, match=rf"{name}: {problem}"):
            imported(tmp_path / name)
    assert capfd.readouterr() == ("", "")


def append(path: Path, data: np.ndarray, properties: dict[str, Any], mode: str = "a") -> None:
    with TdmsWriter(path, mode=mode) as writer:
        writer.write_segment([ChannelObject("g", "c", data, properties)])


def restarted(path: Path, pause_s: float) -> Path:
    """Write one second of samples, and another one that begins `pause_s` after its end."""
    append(path, np.zeros(12_800), TIMING, "w")
    start = START + np.timedelta64(round(1e6 * (1.0 + pause_s)), "us")
    for half in np.split(np.ones(12_800), 2):  # the second half goes on: the same start time, stated again
        append(path, half, TIMING | {"wf_start_time": start})
    return path


@pytest.mark.parametrize("pause_s", [0.0, 0.5, 59.0])
def test_pause_before_a_restart_is_a_gap(tmp_path: Path, pause_s: float) -> None:
    blocks = imported(restarted(tmp_path / "run.tdms", pause_s))
    assert lost_in(blocks) == ([(round(12_800 * (1 + pause_s)), round(12_800 * pause_s))] if pause_s else [])
    begin = next(block for block in blocks if block.force[0] == 1.0)
    assert begin.stamp_ns == START_NS + round((1.0 + pause_s) * NS)
    assert blocks[0].stamp_ns == START_NS


def test_restart_before_the_end_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BagError, match=r"sample 12800: wf_start_time is 0.500000 s before the end"):
        imported(restarted(tmp_path / "run.tdms", -0.5))


def test_rate_that_changes_is_refused(tmp_path: Path) -> None:
    path = restarted(tmp_path / "run.tdms", 1.0)
    append(path, np.ones(10), {"wf_increment": 1e-3})
    with pytest.raises(BagError, match="wf_increment changes from"):
        imported(path)


@pytest.mark.parametrize("unit", ["s", "ms", None])
def test_times_of_a_channel(tmp_path: Path, unit: str | None) -> None:
    seconds = np.arange(1000) / 500.0
    times = {None: START + (seconds * 1e6).astype("timedelta64[us]"), "s": seconds, "ms": 1e3 * seconds}[unit]
    properties = {"unit_string": unit} if unit else {}
    path = write(
        tmp_path / "run.tdms", {"g/Time": (times, properties), "g/Force": (np.arange(1000.0), {"unit_string": "N"})}
    )
    for settings in ({}, {"time_column": "Time"}, {"time_column": "g/Time"}):
        blocks = imported(path, **settings)
        assert force_of(blocks) == [*range(1000)]
        assert blocks[0].sample_rate == pytest.approx(500.0)
        assert blocks[0].stamp_ns == (0 if unit else START_NS)


def test_times_without_a_unit_that_are_no_seconds_are_refused(tmp_path: Path) -> None:
    force = np.arange(1000.0), {"unit_string": "N"}
    path = write(tmp_path / "run.tdms", {"g/Time": (np.arange(1000) * 2.0, {}), "g/Force": force})
    with pytest.raises(BagError, match=r"g/Time: states no unit, and in seconds the rate would be 0\.5 Hz; must state"):
        imported(path)


def test_period_in_another_unit(tmp_path: Path) -> None:
    period = {"wf_increment": 2.0, "wf_xunit_string": "ms"}
    path = write(tmp_path / "run.tdms", {"g/Force": (np.arange(1000.0), TIMING | {"unit_string": "N"} | period)})
    assert imported(path)[0].sample_rate == pytest.approx(500.0)
    path = write(tmp_path / "bare.tdms", {"g/Force": (np.arange(1000.0), {"unit_string": "N", "wf_increment": 2.0})})
    with pytest.raises(BagError, match=r"g/Force: wf_increment: states no unit, .* would be 0\.5 Hz"):
        imported(path)


def test_channel_whose_scaling_is_damaged_is_refused(tmp_path: Path) -> None:
    scaling = {"NI_Number_Of_Scales": 1, "wf_increment": 1e-3, "unit_string": "N"}
    path = write(tmp_path / "run.tdms", {"g/Force": (np.arange(100, dtype=np.int16), scaling)})
    with pytest.raises(BagError, match="cannot be read: "):
        imported(path)


def test_channel_without_times_needs_a_rate(tmp_path: Path) -> None:
    path = write(tmp_path / "run.tdms", {"g/c": (FORCE, {"unit_string": "N"})})
    with pytest.raises(
        BagError, match=r"wf_increment = missing: .*; state --rate HZ, or the channel of the times with"
    ):
        imported(path)
    blocks = imported(path, rate=1000.0)
    assert (blocks[0].sample_rate, len(force_of(blocks))) == (1000.0, len(FORCE))
    with pytest.raises(SettingsError, match="rate = 1000: must be empty, the file has times"):
        imported(write(tmp_path / "timed.tdms", {"g/c": (FORCE, TIMING)}), rate=1000.0)
