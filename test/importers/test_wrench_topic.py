# SPDX-License-Identifier: Apache-2.0
"""Import of force from topics of wrenches and numbers in a bag."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.typesys import Stores, get_typestore

from scara_effmass.bags.writer import BagWriter
from scara_effmass.errors import BagError, SettingsError
from scara_effmass.importers.force import import_force
from scara_effmass.settings import ImportSettings
from scara_effmass.values import RunInfo
from scara_effmass.wire.message_types import FLOAT64, FORCE_BLOCK, STRING, WRENCH, WRENCH_STAMPED
from scara_effmass.wire.message_types import RUN_INFO as RUN_INFO_TYPE
from scara_effmass.wire.run_info import run_info_message
from scara_effmass.wire.topics import RUN_INFO
from test.bags.messages import header, message, serialized
from test.importers.conftest import force_of, imported, lost_in

NS = 10**9
MS = 10**6
T0 = 1_700_000_000 * NS
TRUNCATED = b"\x00\x01\x00\x00"

Messages = list[tuple[str, str, int, bytes]]


def wrench(force_z: float, force_x: float = 1.0) -> object:
    force, torque = (
        message("geometry_msgs/msg/Vector3", dict(zip("xyz", values, strict=True)))
        for values in ((force_x, 2.0, force_z), (0.0, 0.0, 0.0))
    )
    return message(WRENCH, {"force": force, "torque": torque})


def wrenches(stamps_ns: Iterable[int], log_times_ns: Iterable[int]) -> Messages:
    """Return wrenches whose force along z is their index."""
    return [
        (
            "/wrench",
            WRENCH_STAMPED,
            int(log_ns),
            serialized(WRENCH_STAMPED, {"header": header(int(stamp_ns), "ft"), "wrench": wrench(float(number))}),
        )
        for number, (stamp_ns, log_ns) in enumerate(zip(stamps_ns, log_times_ns, strict=True))
    ]


def floats(times_ns: Iterable[int], topic: str = "/load") -> Messages:
    """Return numbers that are their own index."""
    return [
        (topic, FLOAT64, time_ns, serialized(FLOAT64, {"data": float(number)}))
        for number, time_ns in enumerate(times_ns)
    ]


def write(path: Path, messages: Messages) -> Path:
    with BagWriter(path) as bag:
        for entry in messages:
            bag.write(*entry)
    return path


TIMES_NS = [T0 + n * 10 * MS for n in range(100)]


def test_wrench_gives_the_selected_axis_at_the_rate_of_its_stamps(tmp_path: Path) -> None:
    stamps_ns = T0 + np.arange(1000) * 2 * MS
    path = write(tmp_path / "run", wrenches(stamps_ns, stamps_ns + 3 * MS))
    blocks = imported(path)
    assert force_of(blocks) == list(range(1000))
    assert [(b.stamp_ns, len(b.force)) for b in blocks] == [(T0 + n * 100 * MS, 50) for n in range(20)]
    assert blocks[0].sample_rate == pytest.approx(500.0)
    assert blocks[0].source == "run, /wrench force.z"
    assert set(force_of(imported(path, axis="y"))) == {2.0}
    # without the median force of the first second, to which the sensor's bias belongs
    assert force_of(imported(path, axis="norm")) == pytest.approx([abs(n - 250.0) for n in range(1000)])
    assert imported(path, axis="norm")[0].source == "run, /wrench force.norm less (1.0, 2.0, 250.0)"


@pytest.mark.parametrize(
    ("force_x", "axis", "loss"),
    [
        (312.0, "z", "/wrench force.z: up to 50.0 N, with the other axes up to 316.0 N: --axis norm"),
        (312.0, "x", ""),
        (312.0, "norm", ""),
        (15.0, "z", ""),  # less than 10 % more
    ],
)
def test_a_contact_on_other_axes_is_said(tmp_path: Path, force_x: float, axis: str, loss: str) -> None:
    stamps_ns = T0 + np.arange(3000) * MS
    content = [
        {"header": header(stamp, "ft"), "wrench": wrench(*((50.0, force_x) if 2000 <= n < 2020 else (0.0, 0.0)))}
        for n, stamp in enumerate(stamps_ns.tolist())
    ]
    messages = [
        ("/wrench", WRENCH_STAMPED, stamp, serialized(WRENCH_STAMPED, item))
        for stamp, item in zip(stamps_ns.tolist(), content, strict=True)
    ]
    file, blocks = import_force(write(tmp_path / "run", messages), ImportSettings(axis=axis))
    list(blocks)
    assert [line.partition("run: ")[2] for line in file.losses()] == ([loss] if loss else [])


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"rate": 5.0}, "rate = 5.0: must not be stated, messages have times"),
        ({"time_column": "t"}, "time_column = t: must not be stated, messages have times"),
        ({"header": False}, "header = False: must not be stated, messages have times"),
        ({"axis": "norm", "sensor.invert": True}, "sensor.invert = True: must not be stated, a norm has no sign"),
    ],
)
def test_a_setting_without_effect_is_refused(tmp_path: Path, settings: dict[str, Any], message: str) -> None:
    path = write(tmp_path / "run", wrenches(TIMES_NS, TIMES_NS))
    with pytest.raises(SettingsError, match=f"run: /wrench: {message}"):
        imported(path, **settings)


def test_numbers_that_are_missing_at_the_end_are_a_loss(tmp_path: Path) -> None:
    nan = serialized(FLOAT64, {"data": float("nan")})
    messages = [*floats(TIMES_NS[:90]), *(("/load", FLOAT64, time_ns, nan) for time_ns in TIMES_NS[90:])]
    file, blocks = import_force(path := write(tmp_path / "run", messages), ImportSettings())
    assert len(force_of(list(blocks))) == 90
    assert file.losses() == (f"{path}: the first 0 and the last 10 samples are no numbers",)


def test_wrenches_of_two_sensors_are_refused(tmp_path: Path) -> None:
    left = wrenches(TIMES_NS[::2], TIMES_NS[::2])
    stamped = {"header": header(TIMES_NS[1], "up"), "wrench": wrench(0.0)}
    other = ("/wrench", WRENCH_STAMPED, TIMES_NS[99], serialized(WRENCH_STAMPED, stamped))
    path = write(tmp_path / "run", [*left, other])
    with pytest.raises(BagError, match="run: /wrench: frame_id = ft, up: must be one"):
        imported(path)


def test_messages_with_a_frozen_stamp_are_left_out_with_their_largest_value(tmp_path: Path) -> None:
    stamps_ns = T0 + np.arange(1000) * MS
    log_times_ns = stamps_ns.copy()
    stamps_ns[501:597] = stamps_ns[500]
    file, blocks = import_force(write(tmp_path / "run", wrenches(stamps_ns, log_times_ns)), ImportSettings())
    assert lost_in(list(blocks)) == [(597, 96)]
    (loss,) = file.losses()
    assert "/wrench: the stamp is frozen: messages left out: 96, from 1700000000.501000 s on" in loss
    assert loss.endswith(", values up to 596.0")


def test_messages_are_sorted_gaps_counted_and_invalid_stamps_left_out(tmp_path: Path) -> None:
    stamps_ns = T0 + np.arange(2000) * MS
    log_times_ns = stamps_ns + 200 * MS
    rng = np.random.default_rng(3)
    kept = np.delete(np.arange(2000), slice(1200, 1300))
    swapped = kept[np.argsort(kept + rng.uniform(0, 20, len(kept)), kind="stable")]
    stamps_ns = stamps_ns[swapped]
    invalid = {5: 0, 700: T0 - 3600 * NS, 1500: T0 + 3600 * NS}
    for at, stamp_ns in invalid.items():
        stamps_ns[at] = stamp_ns
    path = write(tmp_path / "run", wrenches(stamps_ns, np.sort(log_times_ns[kept])))
    file, imported_blocks = import_force(path, ImportSettings())
    blocks = list(imported_blocks)
    (loss,) = file.losses()
    assert "deviates from the log time by more than 5 s: messages left out: 3, from " in loss
    assert loss.endswith("values up to 1500.0")
    expected = np.delete(kept, np.searchsorted(kept, swapped[list(invalid)]))
    order = {int(number): at for at, number in enumerate(swapped)}
    assert force_of(blocks) == [float(order[int(number)]) for number in expected]
    assert sum(block.lost_samples for block in blocks) == 103
    numbers = np.concatenate([b.first_sample + np.arange(len(b.force)) for b in blocks])
    assert numbers.tolist() == (expected - expected[0]).tolist()


@pytest.mark.parametrize("step_s", [-20.0, -5.0, -0.3, -0.05, 0.05, 0.3, 5.0])
@pytest.mark.parametrize("burst", [1, 10])
@pytest.mark.parametrize("at", [10, 1000, 1990])
def test_a_clock_step_of_any_size_is_refused(tmp_path: Path, step_s: float, burst: int, at: int) -> None:
    rng = np.random.default_rng(1)
    stamps_ns = T0 + np.arange(2000) * 2 * MS
    log_times_ns = T0 + np.arange(2000) // burst * burst * 2 * MS + rng.integers(0, MS, 2000)
    stamps_ns[at:] += round(step_s * NS)
    path = write(tmp_path / "run", wrenches(stamps_ns, np.sort(log_times_ns)))
    with pytest.raises(BagError, match=rf"from .* s on, its stamps deviate by {step_s:.3f} s; .* without a clock step"):
        imported(path)


@pytest.mark.parametrize("lost", [0, 150])
def test_a_stall_of_the_recorder_is_no_clock_step(tmp_path: Path, lost: int) -> None:
    stamps_ns = T0 + np.arange(2000) * 2 * MS
    log_times_ns = stamps_ns.copy()
    log_times_ns[1000:1250] = stamps_ns[1250] + np.arange(250) * 1000  # they arrive together
    kept = np.delete(np.arange(2000), slice(1000, 1000 + lost))
    blocks = imported(write(tmp_path / "run", wrenches(stamps_ns[kept], log_times_ns[kept])))
    assert sum(block.lost_samples for block in blocks) == lost
    assert force_of(blocks) == [float(number) for number in range(2000 - lost)]


@pytest.mark.parametrize("count", [1500, 12_000])
def test_clock_step_during_the_recording_is_refused(tmp_path: Path, count: int) -> None:
    log_times_ns = T0 + np.arange(count) * MS
    stamps_ns = log_times_ns.copy()
    stamps_ns[count - 400 :] -= 60 * NS
    path = write(tmp_path / "run", wrenches(stamps_ns, log_times_ns))
    with pytest.raises(
        BagError, match=r"from .* s on, its stamps deviate by -60.000 s; must be recorded without a clock step"
    ):
        imported(path)


def test_messages_without_stamps_are_placed_by_their_log_times(tmp_path: Path) -> None:
    bare = [("/bare", WRENCH, time, serialized(WRENCH, {"force": f, "torque": f})) for time, f in (
        (time, message("geometry_msgs/msg/Vector3", {"x": 0.0, "y": 0.0, "z": float(n)}))
        for n, time in enumerate(TIMES_NS)
    )]  # fmt: skip
    for name, messages in (("load", floats(TIMES_NS)), ("bare", bare), ("wrench", wrenches([0] * 100, TIMES_NS))):
        blocks = imported(write(tmp_path / name, messages), unit="kN")
        assert blocks[0].source.endswith("at log times")
        assert force_of(blocks) == [1000.0 * n for n in range(100)]
        assert [block.stamp_ns for block in blocks] == TIMES_NS[::10]


def test_voltage_topic_is_divided_by_the_sensitivity(tmp_path: Path) -> None:
    path = write(tmp_path / "run", floats(TIMES_NS))
    force = force_of(imported(path, unit="mV", **{"sensor.sensitivity": 4.0}))
    assert force == pytest.approx([n / 4.0 for n in range(100)])


def test_message_that_cannot_be_decoded_is_lost(tmp_path: Path) -> None:
    messages = floats(TIMES_NS)
    messages[40] = (*messages[40][:3], TRUNCATED)
    file, blocks = import_force(write(tmp_path / "some", messages), ImportSettings())
    assert lost_in(list(blocks)) == [(41, 1)]
    (loss,) = file.losses()
    assert ": /load: left out: std_msgs/msg/Float64 cannot be decoded" in loss
    broken: Messages = [(*entry[:3], TRUNCATED) for entry in messages]
    with pytest.raises(BagError, match=r"all: /load: no message can be decoded; .*std_msgs/msg/Float64"):
        imported(write(tmp_path / "all", broken))


def test_truncated_bag_is_imported_up_to_the_cut(tmp_path: Path) -> None:
    noise = np.random.default_rng(5).normal(size=60_000)
    messages = [("/load", FLOAT64, T0 + n * MS, serialized(FLOAT64, {"data": value})) for n, value in enumerate(noise)]
    path = write(tmp_path / "run.mcap", messages)
    path.write_bytes(path.read_bytes()[: int(0.4 * path.stat().st_size)])
    file, blocks = import_force(path, ImportSettings())
    values = force_of(list(blocks))
    assert 1000 < len(values) < len(noise)
    assert values == noise[: len(values)].tolist()
    assert "cut off" in "; ".join(file.losses())


def test_stamped_wrench_is_selected_before_other_types(tmp_path: Path) -> None:
    messages = [*wrenches(TIMES_NS, TIMES_NS), *floats(TIMES_NS)]
    assert imported(write(tmp_path / "run", messages))[0].source == "run, /wrench force.z"


def test_ambiguous_or_missing_topic_is_refused(tmp_path: Path) -> None:
    two = write(tmp_path / "two", [*floats(TIMES_NS, "/a"), *floats(TIMES_NS, "/b")])
    choices = r"must be one of /a \(std_msgs/msg/Float64\), /b \(.*\)"
    with pytest.raises(BagError, match=rf"two: topic is empty: {choices}"):
        imported(two)
    with pytest.raises(BagError, match=rf"two: topic = /c: {choices}"):
        imported(two, topic="/c")
    assert len(force_of(imported(two, topic="b"))) == 100
    none = write(tmp_path / "none", [("/s", STRING, T0, serialized(STRING, {"data": ""}))])
    for topic in ("", "/s"):
        with pytest.raises(BagError, match="has no topic of type geometry_msgs/msg/WrenchStamped, geometry_msgs"):
            imported(none, topic=topic)
    with pytest.raises(BagError, match="one: /load: has 1 samples; must have at least 2"):
        imported(write(tmp_path / "one", floats([T0])))


def test_bag_with_force_blocks_needs_no_import(tmp_path: Path) -> None:
    path = write(tmp_path / "run", [("/force", FORCE_BLOCK, T0, TRUNCATED), *floats(TIMES_NS)])
    with pytest.raises(BagError, match="run: already has ForceBlocks on /force; needs no import"):
        imported(path)
    assert len(force_of(imported(path, topic="/load"))) == 100


@pytest.mark.parametrize("simulated", [True, False])
def test_simulated_recording_gives_simulated_force(tmp_path: Path, *, simulated: bool) -> None:
    info = (f"/{RUN_INFO}", RUN_INFO_TYPE, T0, run_info_message(RunInfo(simulated=simulated)))
    blocks = imported(write(tmp_path / "run", [info, *wrenches(TIMES_NS, TIMES_NS)]))
    assert {block.simulated for block in blocks} == {simulated}


def test_ros1_bag_is_imported(tmp_path: Path) -> None:
    ros1 = get_typestore(Stores.ROS1_NOETIC)
    make: dict[str, Any] = dict(ros1.types)
    with Ros1Writer(tmp_path / "ros1.bag") as bag:
        connection = bag.add_connection("/ft", WRENCH_STAMPED, typestore=ros1)
        for n in range(100):
            stamp = make["builtin_interfaces/msg/Time"](T0 // NS, n * MS)
            vectors = [make["geometry_msgs/msg/Vector3"](0.0, 0.0, float(n)) for _ in range(2)]
            whole = make[WRENCH_STAMPED](make["std_msgs/msg/Header"](n, stamp, "ft"), make[WRENCH](*vectors))
            bag.write(connection, T0 + n * MS, ros1.serialize_ros1(whole, WRENCH_STAMPED))
    assert force_of(imported(tmp_path / "ros1.bag")) == list(range(100))
