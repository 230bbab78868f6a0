# SPDX-License-Identifier: Apache-2.0
"""Force from the ForceBlocks of a bag: gaps, damage, and what is refused."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from scara_effmass.bags.writer import BagWriter
from scara_effmass.daq.bag_source import BagSource
from scara_effmass.daq.conditioning import SignalConditioner
from scara_effmass.daq.source import Reading
from scara_effmass.errors import BagError, SettingsError
from scara_effmass.settings import BagSettings, DaqSettings, SensorSettings, TareSettings
from scara_effmass.settings.loading import FrozenSettings
from scara_effmass.values import ForceBlock
from scara_effmass.wire.force import force_block_message
from scara_effmass.wire.message_types import FLOAT64, FORCE_BLOCK, WRENCH, WRENCH_STAMPED
from test.bags.messages import header, message, serialized
from test.daq.force_bag import MS, START_NS, block_messages, force_block, write_blocks, write_messages

NS = 10**9


@contextmanager
def opened(path: Path, topic: str = "") -> Iterator[BagSource]:
    source = BagSource(DaqSettings(bag=BagSettings(path=str(path), topic=topic, rate=0.0)), lambda: START_NS)
    source.start()
    try:
        yield source
    finally:
        source.close()


def played(path: Path, topic: str = "") -> list[Reading]:
    with opened(path, topic) as source:
        return list(iter(lambda: source.read(0.0), None))


def published(path: Path, **settings: FrozenSettings) -> list[ForceBlock]:
    """Return the blocks that `daq_node` publishes."""
    daq = DaqSettings.model_validate({"bag": BagSettings(path=str(path), rate=0.0), **settings})
    source = BagSource(daq, lambda: START_NS)
    source.start()
    signal = SignalConditioner(source, daq)
    blocks = [block for reading in iter(lambda: source.read(0.0), None) for block in signal.blocks(reading)[0]]
    source.close()
    return blocks


@pytest.mark.parametrize("delay_ms", [3, 50, 70])
@pytest.mark.parametrize("source", ["test", "other"])
def test_blocks_of_two_publishers_are_refused(tmp_path: Path, delay_ms: int, source: str) -> None:
    """Played as one signal, each block would be a restart, in which an impact or a held force is lost."""
    blocks = [force_block(100 * number) for number in range(10)]
    others = [
        block._replace(stamp_ns=block.stamp_ns + delay_ms * MS, first_sample=block.first_sample + 777, source=source)
        for block in blocks
    ]
    path = write_blocks(tmp_path / "run", sorted(blocks + others, key=lambda block: block.stamp_ns))
    with pytest.raises(BagError, match=r"run: /force: blocks at .* s overlap in time; must be of one publisher"):
        played(path)


def numbers(readings: list[Reading]) -> list[tuple[int, int]]:
    return [(reading.first_sample, reading.lost) for reading in readings]


def test_blocks_are_played_unchanged(tmp_path: Path) -> None:
    blocks = [
        force_block(5000),
        force_block(5100, 50, saturated_samples=np.array([3], np.uint32), relative_uncertainty=0.02),
        force_block(5150),
    ]
    path = write_blocks(tmp_path / "run", blocks)
    with opened(path) as source:
        assert (source.channels, source.sample_rate, source.simulated) == (("force",), 1000.0, False)
        assert source.description == "recorded: run, /force, of test"
    readings = played(path)
    assert numbers(readings) == [(0, 0), (100, 0), (150, 0)]
    assert [(r.stamp_ns, r.clock_residual, r.relative_uncertainty) for r in readings] == [
        (block.stamp_ns, 1e-5, block.relative_uncertainty) for block in blocks
    ]
    for reading, block in zip(readings, blocks, strict=True):
        assert reading.samples.tolist() == [block.force.tolist()]
        assert not reading.samples.flags.writeable
        marks = [] if reading.saturated is None else np.flatnonzero(reading.saturated[0]).tolist()
        assert marks == block.saturated_samples.tolist()


@pytest.mark.parametrize("at_start", [True, False])
@pytest.mark.parametrize("invert", [True, False])
def test_tare_of_a_recording_is_subtracted_once(tmp_path: Path, *, at_start: bool, invert: bool) -> None:
    """The recording has the tare at its start, and another one in a press of 60 N, as a live `daq_node` records it."""
    raw, stamp_ns = np.full(100, 20.0), START_NS + 499 * MS
    tares = [(0.0, 0)] * 5 + [(20.0, stamp_ns)] * 5 + [(80.0, stamp_ns + NS)] * 5
    blocks = [
        force_block(100 * number, force=raw + 60.0 * (number >= 7) - tare[0], tare=tare[0], tare_stamp_ns=tare[1])
        for number, tare in enumerate(tares)
    ]
    path = write_blocks(tmp_path / "run", blocks)
    sign = -1.0 if invert else 1.0
    sensor, tare = SensorSettings(invert=invert), TareSettings(at_start=at_start)
    for block, again in zip(blocks, published(path, sensor=sensor, tare=tare), strict=True):
        assert again.force == pytest.approx(sign * block.force)
        assert again.tare == pytest.approx(sign * block.tare)
        assert again.tare_stamp_ns == block.tare_stamp_ns


def test_each_block_keeps_the_rate_that_the_fit_of_the_clock_gave_it(tmp_path: Path) -> None:
    """With that of the first block, stamps within later ones would be early or late."""
    rates = [1000.0, 1000.2, 999.9]
    path = write_blocks(tmp_path / "run", [force_block(100 * n, sample_rate=rate) for n, rate in enumerate(rates)])
    assert [block.sample_rate for block in published(path)] == rates


def test_samples_missing_between_blocks_are_counted(tmp_path: Path) -> None:
    restarted = force_block(0, stamp_ns=START_NS + 950 * MS)
    blocks = [
        force_block(0),
        force_block(200, lost_samples=100),
        force_block(400),
        force_block(500, lost_samples=7, stamp_ns=START_NS + 507 * MS),
        restarted,
        restarted,
        force_block(100, stamp_ns=START_NS + 1050 * MS),
        force_block(0, stamp_ns=START_NS + 2000 * MS),
    ]
    readings = played(write_blocks(tmp_path / "run", blocks))
    assert numbers(readings) == [(0, 0), (200, 100), (400, 100), (507, 7), (950, 343), (1050, 0), (2000, 850)]


def test_drifting_rate_is_accepted_and_another_rate_is_refused(tmp_path: Path) -> None:
    good = [force_block(0), force_block(100, sample_rate=1000.01), force_block(200, sample_rate=999.98)]
    assert numbers(played(write_blocks(tmp_path / "good", good))) == [(0, 0), (100, 0), (200, 0)]
    bad = write_blocks(tmp_path / "bad", [*good, force_block(300, sample_rate=2000.0)])
    with pytest.raises(BagError, match=r"bad: /force: sample_rate = 2000 at 1700000000.300000 s: must be 1000 Hz"):
        played(bad)


def test_block_with_an_impossible_clock_residual_is_refused(tmp_path: Path) -> None:
    path = write_blocks(tmp_path / "run", [force_block(0)._replace(clock_residual=np.inf)])
    with pytest.raises(BagError, match=r"run: /force: clock_residual = inf at .* s: must be a number >= 0"):
        played(path)


def test_block_with_an_impossible_uncertainty_is_left_out(tmp_path: Path) -> None:
    path = write_blocks(tmp_path / "run", [force_block(0)._replace(relative_uncertainty=float("nan"))])
    with pytest.raises(BagError, match=r"left out: ForceBlock: relative_uncertainty = nan: must be 0 to 1"):
        played(path)


@pytest.mark.parametrize("rate", [0.0, float("nan")])
def test_block_without_a_usable_rate_is_left_out(tmp_path: Path, rate: float) -> None:
    bad = force_block(100)._replace(sample_rate=rate)
    with opened(write_blocks(tmp_path / "run", [force_block(0), bad, force_block(200)])) as source:
        assert numbers(list(iter(lambda: source.read(0.0), None))) == [(0, 0), (200, 100)]
    alone = write_blocks(tmp_path / "alone", [bad])
    with pytest.raises(
        BagError, match=rf"has no force that can be read; .*left out: ForceBlock: sample_rate = {rate:g}: "
    ):
        played(alone)


def test_clock_that_goes_back_is_refused_after_the_blocks_before(tmp_path: Path) -> None:
    messages = block_messages([force_block(0), force_block(100)])
    late = force_block_message(force_block(200, stamp_ns=START_NS - 10 * NS))
    messages += [("/force", FORCE_BLOCK, START_NS + NS, late)]
    with opened(write_messages(tmp_path / "run", messages)) as source:
        assert [source.read(0.0) is not None for _ in range(2)] == [True, True]
        with pytest.raises(BagError, match=r"run: /force: time goes back, 1699999990.000000 s follows 1700000000.2"):
            source.read(0.0)


def test_block_that_cannot_be_decoded_is_lost(tmp_path: Path) -> None:
    good = block_messages([force_block(0), force_block(100), force_block(200)])
    broken = [*good[:1], (*good[1][:3], good[1][3][:50]), *good[2:]]
    assert numbers(played(write_messages(tmp_path / "some", broken))) == [(0, 0), (200, 100)]
    with pytest.raises(BagError, match=r"all: /force: has no force that can be read; .*ForceBlock: .*length 100"):
        played(write_messages(tmp_path / "all", broken[1:2]))


def test_simulated_block_makes_the_source_simulated(tmp_path: Path) -> None:
    path = write_blocks(tmp_path / "run", [force_block(0), force_block(100, simulated=True), force_block(200)])
    with opened(path) as source:
        assert [(source.read(0.0) is not None, source.simulated)[1] for _ in range(3)] == [False, True, True]
    with opened(write_blocks(tmp_path / "computed", [force_block(0, simulated=True)])) as source:
        assert (source.simulated, source.description) == (True, "recorded, simulated: computed, /force, of test")
    block = force_block(0, simulated=True)._replace(source="simulated force: noise")
    with opened(write_blocks(tmp_path / "noise", [block])) as source:
        assert source.description == "recorded: noise, /force, of simulated force: noise"


def test_truncated_bag_is_played_up_to_the_cut(tmp_path: Path) -> None:
    noise = np.random.default_rng(5).normal(size=2000)
    path = write_blocks(tmp_path / "run.mcap", (force_block(2000 * n, 2000, force=noise + n) for n in range(100)))
    path.write_bytes(path.read_bytes()[: int(0.9 * path.stat().st_size)])
    with opened(path) as source:
        count = len(list(iter(lambda: source.read(0.0), None)))
        assert 50 <= count < 100
        assert source.ended
        assert all(loss.startswith(f"{path}: ") for loss in source.losses)
        assert "cut off" in "; ".join(source.losses)


def test_value_that_is_not_finite_is_nan(tmp_path: Path) -> None:
    force = np.array([1.0, np.nan, np.inf, -np.inf, 1e10, 2.0])
    (reading,) = played(write_blocks(tmp_path / "run", [force_block(0, force=force)]))
    assert np.isnan(reading.samples[0]).tolist() == [False, True, True, True, True, False]


def test_ambiguous_topic_is_refused(tmp_path: Path) -> None:
    messages = [message for name in ("ai0", "ai1") for message in block_messages([force_block(0)], f"/force/{name}")]
    path = write_messages(tmp_path / "two", messages)
    for topic, setting in (("", "bag.topic is empty"), ("/f", "bag.topic = /f")):
        with pytest.raises(BagError, match=f"two: {setting}: must be one of /force/ai0 .*, /force/ai1 "):
            played(path, topic)
    assert len(played(path, "force/ai1")) == 1


@pytest.mark.parametrize(("axis", "force"), [("z", 12.0), ("y", -4.0), ("norm", 0.0)])
def test_wrenches_are_played_where_there_are_no_force_blocks(tmp_path: Path, axis: str, force: float) -> None:
    """The norm is that of the change, and the force is constant."""
    vector = message("geometry_msgs/msg/Vector3", {"x": 3.0, "y": -4.0, "z": 12.0})
    wrench = message(WRENCH, {"force": vector, "torque": vector})
    stamps_ns = [START_NS + n * MS for n in range(300)]
    fields = [{"header": header(stamp_ns, "ft"), "wrench": wrench} for stamp_ns in stamps_ns]
    wrenches = [
        ("/ft", WRENCH_STAMPED, stamp_ns, serialized(WRENCH_STAMPED, values))
        for stamp_ns, values in zip(stamps_ns, fields, strict=True)
    ]
    path = write_messages(tmp_path / "wrist", wrenches)
    bag = BagSettings(path=str(path), rate=0.0, axis=axis, unit="kN")
    source = BagSource(DaqSettings(bag=bag, sensor=SensorSettings(invert=axis != "norm")), lambda: START_NS)
    source.start()
    readings = list(iter(lambda: source.read(0.0), None))
    source.close()
    assert source.ended
    assert [reading.stamp_ns for reading in readings] == [START_NS + n * 100 * MS for n in range(3)]
    assert np.concatenate([reading.samples[0] for reading in readings]) == pytest.approx(1e3 * force)
    if axis == "norm":
        inverted = BagSource(DaqSettings(bag=bag, sensor=SensorSettings(invert=True)), lambda: START_NS)
        with pytest.raises(SettingsError, match=r"/ft: sensor\.invert = True: must not be stated, a norm has no sign"):
            inverted.start()


def test_file_without_force_blocks_is_refused_with_the_remedy(tmp_path: Path) -> None:
    number = serialized(FLOAT64, {"data": 1.0})
    bag = write_messages(tmp_path / "wrist", [("/load", FLOAT64, START_NS, number)])
    table = tmp_path / "cell.csv"
    table.write_text("t (s),f (N)\n0,1\n", encoding="utf-8")
    for path, problem in (
        (bag, f"has no topic of type {FORCE_BLOCK}, {WRENCH_STAMPED}, {WRENCH}"),
        (table, "is not a bag"),
    ):
        with pytest.raises(BagError) as refusal:
            played(path)
        remedy = f"convert its force first: scara-effmass import {path} -o BAG"
        assert str(refusal.value) == f"{path}: {problem}; {remedy}"


def test_missing_bag_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match=r"bag.path is empty: must be the bag to play"):
        BagSource(DaqSettings(), lambda: START_NS).start()
    with pytest.raises(BagError, match=r"nowhere.csv: does not exist"):
        played(tmp_path / "nowhere.csv")


def test_other_definition_of_force_block_is_refused(tmp_path: Path) -> None:
    types = get_typestore(Stores.ROS2_JAZZY)
    types.register(get_types_from_msg("std_msgs/Header header\nfloat64[] force", FORCE_BLOCK))
    with BagWriter(tmp_path / "old", types=types) as bag:
        bag.write("/force", FORCE_BLOCK, START_NS, force_block_message(force_block(0)))
    with pytest.raises(BagError, match=r"old: definition of .*ForceBlock: must be that of this version"):
        played(tmp_path / "old")
