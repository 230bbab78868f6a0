"""Force out of bags: our own blocks, wrenches and plain numbers, with all that real recordings do to their times."""

from __future__ import annotations

import json
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Ros2Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from scara_effmass.bags.definitions import known_types
from scara_effmass.bags.messages import header, message, serialized
from scara_effmass.bags.writer import BagWriter
from scara_effmass.daq.recorded import RecordedForce
from scara_effmass.daq.source import Unit
from scara_effmass.errors import BagError, SettingsError
from scara_effmass.settings import BagSettings, DaqSettings
from scara_effmass.values import ForceBlock, RunInfo
from scara_effmass.wire.contact_state import float64_message
from scara_effmass.wire.force import force_block_message
from scara_effmass.wire.message_types import FLOAT64, FORCE_BLOCK, RUN_INFO, WRENCH, WRENCH_STAMPED
from scara_effmass.wire.run_info import run_info_message
from scara_effmass.wire.topics import RECORDING_INFO

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from pathlib import Path

    from scara_effmass.daq.source import Reading

NS = 10**9
MS = 10**6
T0 = 1_700_000_000 * NS

Messages = list[tuple[str, str, int, bytes]]


def block(first: int, count: int = 100, **changes: Any) -> ForceBlock:  # noqa: ANN401 - of any field
    force = np.arange(first, first + count, dtype=np.float64)
    base = ForceBlock(
        stamp_ns=T0 + first * MS, frame_id="cell", first_sample=first, sample_rate=1000.0, force=force,
        lost_samples=0, saturated_samples=np.empty(0, np.uint32), clock_residual=1e-5, filter_delay=3e-3, source="test",
        simulated=False, tare=0.0, tare_stamp_ns=0, relative_uncertainty=0.15,
    )  # fmt: skip
    return base._replace(**changes)


def block_messages(blocks: Iterable[ForceBlock], topic: str = "/force") -> Messages:
    return [(topic, FORCE_BLOCK, each.stamp_ns + len(each.force) * MS, force_block_message(each)) for each in blocks]


def vector(x: float, y: float, z: float) -> object:
    return message("geometry_msgs/msg/Vector3", {"x": x, "y": y, "z": z})


def wrench(value: float) -> object:
    return message(WRENCH, {"force": vector(1.0, 2.0, value), "torque": vector(0.0, 0.0, 0.0)})


def wrench_messages(stamps_ns: Iterable[int], log_times_ns: Iterable[int], topic: str = "/wrench") -> Messages:
    """Return wrenches that carry their own number as the force along z."""
    pairs = enumerate(zip(stamps_ns, log_times_ns, strict=True))
    return [
        (
            topic,
            WRENCH_STAMPED,
            int(log_ns),
            serialized(WRENCH_STAMPED, {"header": header(int(stamp_ns), "ft"), "wrench": wrench(float(number))}),
        )
        for number, (stamp_ns, log_ns) in pairs
    ]


def write(path: Path, messages: Messages) -> Path:
    with BagWriter(path) as bag:
        for each in messages:
            bag.write(*each)
    return path


def source(path: Path, block_time: float = 0.1, **bag: Any) -> RecordedForce:  # noqa: ANN401 - of any setting
    settings = DaqSettings(block_time=block_time, bag=BagSettings(path=str(path), **{"rate": 0.0} | bag))
    return RecordedForce(settings, lambda: T0)


@contextmanager
def opened(path: Path, **bag: Any) -> Iterator[RecordedForce]:  # noqa: ANN401 - of any setting
    recorded = source(path, **bag)
    recorded.start()
    try:
        yield recorded
    finally:
        recorded.close()


def played(path: Path, **bag: Any) -> list[Reading]:  # noqa: ANN401 - of any setting
    with opened(path, **bag) as recorded:
        readings = []
        while not recorded.ended:
            reading = recorded.read(0.0)
            readings += [] if reading is None else [reading]
        return readings


def samples(readings: list[Reading]) -> list[float]:
    return [float(value) for reading in readings for value in reading.samples[0]]


def numbers(readings: list[Reading]) -> list[tuple[int, int]]:
    return [(reading.first_sample, reading.lost) for reading in readings]


def test_our_own_blocks_stay_as_they_are(tmp_path: Path) -> None:
    blocks = [block(5000, 100), block(5100, 50, saturated_samples=np.array([3], np.uint32)), block(5150, 100)]
    path = write(tmp_path / "run", block_messages(blocks))
    with opened(path) as recorded:
        assert (recorded.unit, recorded.channels, recorded.sample_rate) == (Unit.NEWTON, ("force",), 1000.0)
        assert recorded.description == "recorded: run, /force, of test"
        assert not recorded.simulated
    readings = played(path)
    assert numbers(readings) == [(0, 0), (100, 0), (150, 0)]
    assert [reading.stamp_ns for reading in readings] == [each.stamp_ns for each in blocks]
    assert [reading.clock_residual for reading in readings] == [1e-5] * 3
    for reading, each in zip(readings, blocks, strict=True):
        assert reading.samples.tolist() == [each.force.tolist()]
        assert not reading.samples.flags.writeable
    assert [None if r.saturated is None else np.flatnonzero(r.saturated[0]).tolist() for r in readings] == [
        None, [3], None,
    ]  # fmt: skip


def test_what_is_missing_between_blocks_is_counted(tmp_path: Path) -> None:
    restarted = block(0, stamp_ns=T0 + 950 * MS)
    blocks = [
        block(0), block(200, lost_samples=100), block(400), block(500, lost_samples=7, stamp_ns=T0 + 507 * MS),
        restarted, restarted, block(100, stamp_ns=T0 + 1050 * MS), block(0, stamp_ns=T0 + 2000 * MS),
    ]  # fmt: skip
    readings = played(write(tmp_path / "run", block_messages(blocks)))
    assert numbers(readings) == [(0, 0), (200, 100), (400, 100), (507, 7), (950, 343), (1050, 0), (2000, 850)]


def test_a_slightly_drifting_rate_is_fine_and_another_one_is_not(tmp_path: Path) -> None:
    good = [block(0), block(100, sample_rate=1000.01), block(200, sample_rate=999.98)]
    assert numbers(played(write(tmp_path / "good", block_messages(good)))) == [(0, 0), (100, 0), (200, 0)]
    bad = write(tmp_path / "bad", block_messages([*good, block(300, sample_rate=2000.0)]))
    with pytest.raises(BagError, match=r"bad: /force: sample_rate changes from 1000 to 2000 Hz at 1700000000.300000 s"):
        played(bad)


@pytest.mark.parametrize("changes", [{"sample_rate": 0.0}, {"sample_rate": float("nan")}, {"clock_residual": np.inf}])
def test_blocks_that_cannot_be_are_refused(tmp_path: Path, changes: dict[str, Any]) -> None:
    with pytest.raises(BagError, match=r"run: /force: sample_rate = .*; a rate above 0 and a number would be right"):
        source(write(tmp_path / "run", block_messages([block(0, **changes)]))).start()


def test_a_clock_that_goes_back_is_refused_after_what_came_before(tmp_path: Path) -> None:
    messages = block_messages([block(0), block(100)])
    messages += [("/force", FORCE_BLOCK, T0 + NS, force_block_message(block(200, stamp_ns=T0 - 10 * NS)))]
    with opened(write(tmp_path / "run", messages)) as recorded:
        assert [recorded.read(0.0) is not None for _ in range(2)] == [True, True]
        with pytest.raises(BagError, match=r"run: /force: time goes back, 1699999990.000000 s follows on 1700000000.2"):
            recorded.read(0.0)


def test_undecodable_blocks_are_missing_and_a_topic_of_them_is_refused(tmp_path: Path) -> None:
    good = block_messages([block(0), block(100), block(200)])
    broken = [*good[:1], (*good[1][:3], good[1][3][:50]), *good[2:]]
    assert numbers(played(write(tmp_path / "some", broken))) == [(0, 0), (200, 100)]
    with pytest.raises(BagError, match=r"all: /force: holds no force that can be read; .*ForceBlock: .*length 100"):
        source(write(tmp_path / "all", broken[1:2])).start()


def test_messages_that_cannot_be_decoded_are_missing_too(tmp_path: Path) -> None:
    times = [T0 + n * 10 * MS for n in range(100)]
    messages: Messages = [("/load", FLOAT64, time, float64_message(n)) for n, time in enumerate(times)]
    messages[40] = (*messages[40][:3], b"\x00\x01\x00\x00")
    readings = played(write(tmp_path / "some", messages))
    assert [(r.first_sample, r.lost) for r in readings if r.lost] == [(41, 1)]
    broken: Messages = [(*each[:3], b"\x00\x01\x00\x00") for each in messages]
    with pytest.raises(BagError, match=r"all: /load: no message can be decoded: .*std_msgs/msg/Float64"):
        source(write(tmp_path / "all", broken)).start()


def test_simulated_comes_from_the_message_and_stays(tmp_path: Path) -> None:
    path = write(tmp_path / "run", block_messages([block(0), block(100, simulated=True), block(200)]))
    with opened(path) as recorded:
        assert [(recorded.read(0.0) is not None, recorded.simulated)[1] for _ in range(3)] == [False, True, True]
    with opened(write(tmp_path / "computed", block_messages([block(0, simulated=True)]))) as computed:
        assert (computed.simulated, computed.description) == (True, "recorded, simulated: computed, /force, of test")


def test_wrenches_give_the_axis_asked_for_at_the_rate_of_their_stamps(tmp_path: Path) -> None:
    stamps_ns = T0 + np.arange(1000) * 2 * MS
    log_times_ns = stamps_ns + 3 * MS
    path = write(tmp_path / "run", wrench_messages(stamps_ns, log_times_ns))
    with opened(path) as recorded:
        assert recorded.sample_rate == pytest.approx(500.0)
        assert recorded.description == "recorded: run, /wrench force.z"
    readings = played(path)
    assert samples(readings) == list(range(1000))
    assert [(r.stamp_ns, r.samples.shape) for r in readings] == [(T0 + n * 100 * MS, (1, 50)) for n in range(20)]
    assert set(samples(played(path, axis="y"))) == {2.0}


def test_disorder_is_put_right_gaps_are_counted_and_odd_stamps_left_out(tmp_path: Path) -> None:
    stamps_ns = T0 + np.arange(2000) * MS
    log_times_ns = stamps_ns + 200 * MS
    rng = np.random.default_rng(3)
    kept = np.delete(np.arange(2000), slice(1200, 1300))
    swapped = kept[np.argsort(kept + rng.uniform(0, 20, len(kept)), kind="stable")]
    stamps_ns = stamps_ns[swapped]
    odd = {5: 0, 700: T0 - 3600 * NS, 1500: T0 + 3600 * NS}
    for at, stamp_ns in odd.items():
        stamps_ns[at] = stamp_ns
    readings = played(write(tmp_path / "run", wrench_messages(stamps_ns, np.sort(log_times_ns[kept]))))
    right = np.delete(kept, np.searchsorted(kept, swapped[list(odd)]))
    order = {int(number): at for at, number in enumerate(swapped)}
    assert samples(readings) == [float(order[int(number)]) for number in right]
    assert sum(reading.lost for reading in readings) == 103
    placed = np.concatenate([r.first_sample + np.arange(r.samples.shape[1]) for r in readings])
    assert placed.tolist() == (right - right[0]).tolist()


def test_what_is_cut_off_is_played_as_far_as_it_goes_and_said(tmp_path: Path) -> None:
    noise = np.random.default_rng(5).normal(size=2000)
    blocks = (block(2000 * n, 2000, force=noise + n) for n in range(100))
    path = write(tmp_path / "run.mcap", block_messages(blocks))
    whole = path.read_bytes()
    path.write_bytes(whole[: int(0.9 * len(whole))])
    with opened(path) as recorded:
        count = 0
        while not recorded.ended:
            count += recorded.read(0.0) is not None
        assert 50 <= count < 100
        assert all(loss.startswith(f"{path}: ") for loss in recorded.losses)
        assert "cut off" in "; ".join(recorded.losses)


@pytest.mark.parametrize("count", [1500, 12_000])
def test_a_clock_that_was_set_while_recording_is_refused(tmp_path: Path, count: int) -> None:
    log_times_ns = T0 + np.arange(count) * MS
    stamps_ns = log_times_ns.copy()
    stamps_ns[count - 400 :] -= 60 * NS
    with pytest.raises(BagError, match=r"its stamps are -60.000 s off from .* a clock that is not set") as refusal:
        played(write(tmp_path / "run", wrench_messages(stamps_ns, log_times_ns)))
    assert str(refusal.value).startswith(f"{tmp_path / 'run'}: /wrench: its stamps")


def test_numbers_and_bare_wrenches_are_placed_by_the_time_of_recording(tmp_path: Path) -> None:
    times = [T0 + n * 10 * MS for n in range(100)]
    floats: Messages = [("/load", FLOAT64, time, float64_message(n)) for n, time in enumerate(times)]
    bare: Messages = [("/bare", WRENCH, time, serialized(WRENCH, {
        "force": vector(0.0, 0.0, n), "torque": vector(0.0, 0.0, 0.0),
    })) for n, time in enumerate(times)]  # fmt: skip
    unfilled = wrench_messages([0] * 100, times)
    for name, messages in (("load", floats), ("bare", bare), ("wrench", unfilled)):
        path = write(tmp_path / name, messages)
        with opened(path, unit="kN") as recorded:
            assert recorded.description.endswith("at the times of recording")
        readings = played(path, unit="kN")
        assert samples(readings) == [1000.0 * n for n in range(100)]
        assert [reading.stamp_ns for reading in readings] == times[::10]


def test_volts_are_volts(tmp_path: Path) -> None:
    path = write(tmp_path / "run", [("/v", FLOAT64, T0 + n * MS, float64_message(n)) for n in range(10)])
    with opened(path, unit="mV") as recorded:
        assert recorded.unit is Unit.VOLT
    assert samples(played(path, unit="mV")) == [0.001 * n for n in range(10)]


def test_what_is_no_number_comes_as_nan(tmp_path: Path) -> None:
    force = np.array([1.0, np.nan, np.inf, -np.inf, 2.0])
    (reading,) = played(write(tmp_path / "run", block_messages([block(0, force=force)])))
    assert np.isnan(reading.samples[0]).tolist() == [False, True, True, True, False]


def test_the_surest_kind_of_topic_is_taken(tmp_path: Path) -> None:
    """A recording of this suite holds decimated wrenches and plain numbers beside the blocks."""
    messages = block_messages([block(0)]) + wrench_messages([T0], [T0])
    messages += [("/allowable_speed", FLOAT64, T0, float64_message(1.0))]
    with opened(write(tmp_path / "run", messages)) as recorded:
        assert recorded.channels == ("force",)


def test_which_topic_it_is_must_be_clear(tmp_path: Path) -> None:
    two = write(tmp_path / "two", block_messages([block(0)]) + block_messages([block(0)], "/force/ai1"))
    right = r"one of /force \(scara_effmass_msgs/msg/ForceBlock\), /force/ai1 \(.*\) would be right"
    with pytest.raises(BagError, match=rf"two: bag.topic is empty; {right}"):
        source(two).start()
    with pytest.raises(BagError, match=rf"two: bag.topic = /f: there is no force; {right}"):
        source(two, topic="/f").start()
    assert len(played(two, topic="force/ai1")) == 1
    none = write(
        tmp_path / "none", [("/s", "std_msgs/msg/String", T0, serialized("std_msgs/msg/String", {"data": ""}))]
    )
    for topic in ("", "/s"):
        with pytest.raises(BagError, match="none of its topics is a scara_effmass_msgs/msg/ForceBlock, geometry_msgs"):
            source(none, topic=topic).start()


def test_what_cannot_be_played_is_said_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match=r"bag.path: is empty; the recording to take force from would be right"):
        RecordedForce(DaqSettings(), lambda: T0).start()
    with pytest.raises(BagError, match="nowhere: does not exist"):
        source(tmp_path / "nowhere").start()
    with pytest.raises(SettingsError, match=r"run: /force: bag.unit = kN, but a ForceBlock is in N"):
        source(write(tmp_path / "run", block_messages([block(0)])), unit="kN").start()
    with pytest.raises(BagError, match="one: /load: holds 1 samples; at least 2 would be right"):
        source(write(tmp_path / "one", [("/load", FLOAT64, T0, float64_message(1.0))])).start()


def test_a_block_defined_otherwise_is_not_decoded(tmp_path: Path) -> None:
    types = get_typestore(Stores.ROS2_JAZZY)
    types.register(get_types_from_msg("std_msgs/Header header\nfloat64[] force", FORCE_BLOCK))
    with BagWriter(tmp_path / "old", types=types) as bag:
        bag.write("/force", FORCE_BLOCK, T0, force_block_message(block(0)))
    with pytest.raises(BagError, match="old: definition of scara_effmass_msgs/msg/ForceBlock: must be that of this"):
        source(tmp_path / "old").start()


def test_a_generated_recording_is_simulated(tmp_path: Path) -> None:
    text = "std_msgs/msg/String"
    messages = wrench_messages([T0, T0 + MS, T0 + 2 * MS], [T0, T0 + MS, T0 + 2 * MS])
    for name, simulated in (("simulated", True), ("measured", False)):
        info = ("/run_info", RUN_INFO, T0, run_info_message(RunInfo(simulated=simulated)))
        with opened(write(tmp_path / name, [info, *messages])) as recorded:
            assert recorded.simulated == simulated
    for name, about, simulated in (
        ("a", {"generated": True}, True),
        ("b", {"generated": False}, False),
        ("c", [], False),
    ):
        info = (RECORDING_INFO, text, T0, serialized(text, {"data": json.dumps(about)}))
        with opened(write(tmp_path / name, [info, *messages])) as recorded:
            assert recorded.simulated == simulated


def test_the_older_formats_are_read_too(tmp_path: Path) -> None:
    messages = block_messages([block(0), block(100)])
    with Ros2Writer(tmp_path / "db3", version=9, storage_plugin=StoragePlugin.SQLITE3) as two:
        connection = two.add_connection("/force", FORCE_BLOCK, typestore=known_types())
        for _, _, log_time_ns, data in messages:
            two.write(connection, log_time_ns, data)
    assert samples(played(tmp_path / "db3")) == list(range(200))

    ros1 = get_typestore(Stores.ROS1_NOETIC)
    make: dict[str, Any] = dict(ros1.types)
    with Ros1Writer(tmp_path / "ros1.bag") as one:
        old = one.add_connection("/ft", WRENCH_STAMPED, typestore=ros1)
        for n in range(100):
            stamp = make["builtin_interfaces/msg/Time"](T0 // NS, n * MS)
            vectors = [make["geometry_msgs/msg/Vector3"](0.0, 0.0, float(n)) for _ in range(2)]
            whole = make[WRENCH_STAMPED](make["std_msgs/msg/Header"](n, stamp, "ft"), make[WRENCH](*vectors))
            one.write(old, T0 + n * MS, ros1.serialize_ros1(whole, WRENCH_STAMPED))
    assert samples(played(tmp_path / "ros1.bag")) == list(range(100))
