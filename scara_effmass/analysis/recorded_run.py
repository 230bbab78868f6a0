# SPDX-License-Identifier: Apache-2.0
"""Run information, force and impacts of one recording."""

from collections import Counter
from collections.abc import Iterable, Iterator
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scara_effmass.analysis.summary import iso_time
from scara_effmass.bags.bag import Bag
from scara_effmass.bags.bag import run_infos as stored_run_infos
from scara_effmass.bags.batches import Topic
from scara_effmass.bags.definitions import check_definition
from scara_effmass.bags.files import open_bag
from scara_effmass.errors import BagError, DecodeError, SettingsError
from scara_effmass.impacts.detector import Detector
from scara_effmass.impacts.impact_matcher import check_run_info
from scara_effmass.importers.force import IMPORTERS, import_force
from scara_effmass.settings import DetectionSettings, ImportSettings
from scara_effmass.values import NAN, FloatArray, ForceBlock, Impact, RunInfo
from scara_effmass.wire.cdr import NS
from scara_effmass.wire.force import decode_force_block, decode_impact
from scara_effmass.wire.message_types import FORCE_BLOCK, IMPACT, WRENCH, WRENCH_STAMPED

USUAL = {FORCE_BLOCK: "force", IMPACT: "impact", WRENCH_STAMPED: "wrench", WRENCH: "wrench"}
"""Usual topic of each type of measurement, in the order of preference."""


class Measurement(NamedTuple):
    """A force block or an impact, and its log time."""

    log_time_ns: int
    value: ForceBlock | Impact


class RecordedForce(NamedTuple):
    """Force (n,) [N] at the ROS times `stamp_ns` (n,), with one NaN in each gap, and the impacts in it."""

    stamp_ns: NDArray[np.int64]
    force: FloatArray
    blocks: int
    lost: int
    simulated: bool
    source: str
    impacts: tuple[Impact, ...]

    def lines(self) -> Iterator[tuple[str, str]]:
        """Yield subject and text of the force and of each impact."""
        samples = np.isfinite(self.force).sum()
        origin = "simulated, not measured" if self.simulated else "as recorded"
        yield "force", f"{self.blocks} blocks, {samples} samples, {self.lost} lost; {origin}: {self.source}"
        for impact in self.impacts:
            text = f"{impact.peak_force:.1f} N, {1e3 * impact.duration:.2f} ms, {impact.impulse:.4f} N s"
            marks = {
                f"rebound {impact.rebound}": impact.rebound,
                "clipped": impact.clipped,
                "incomplete": impact.incomplete,
            }
            parts = [text, *(mark for mark, is_set in marks.items() if is_set)]
            yield "  impact", f"at {iso_time(impact.stamp_ns)}: {', '.join(parts)}"

    def as_dict(self) -> dict[str, Any]:
        """Return the force and its impacts for JSON."""
        return {
            "source": self.source,
            "simulated": self.simulated,
            "blocks": self.blocks,
            "lost_samples": self.lost,
            "impacts": [impact._asdict() for impact in self.impacts],
        }


def run_infos(bag: Bag) -> list[RunInfo]:
    """Return the run information in `bag`; a missing stamp becomes the log time, or 0 in the first one.

    Raises BagError for an invalid value.
    """
    infos: list[RunInfo] = []
    for log_time_ns, info in stored_run_infos(bag):
        try:
            check_run_info(info)
        except SettingsError as error:
            raise BagError(f"{bag.path}: run information: {error}") from None
        infos.append(info._replace(stamp_ns=info.stamp_ns or (log_time_ns if infos else 0)))
    return infos


def read_force(bag: Bag) -> RecordedForce | None:
    """Return the force on the first force topic of `bag`, or None without force. Raises BagError."""
    topic, impact_topic = (
        next((topic.name for topic in bag.topics if topic.type == kind), "") for kind in (FORCE_BLOCK, IMPACT)
    )
    blocks = list(bag.force_blocks(topic)) if topic else []
    if not blocks:
        return None
    stamps: list[NDArray[np.int64]] = []
    forces: list[FloatArray] = []
    for number, block in enumerate(blocks):
        # The first block may count samples lost before the recording began.
        if block.lost_samples and number:
            stamps.append(np.array([block.stamp_ns], np.int64))
            forces.append(np.array([NAN]))
        stamps.append(block.stamp_ns + np.rint(np.arange(len(block.force)) / block.sample_rate * NS).astype(np.int64))
        forces.append(block.force)
    return RecordedForce(
        stamp_ns=np.concatenate(stamps),
        force=np.concatenate(forces),
        blocks=len(blocks),
        lost=sum(block.lost_samples for block in blocks[1:]),
        simulated=any(block.simulated for block in blocks),
        source=blocks[-1].source,
        impacts=tuple(bag.impacts(impact_topic)) if impact_topic else detected_impacts(blocks),
    )


def detected_impacts(blocks: Iterable[ForceBlock]) -> tuple[Impact, ...]:
    """Return the impacts that the detector finds in `blocks` with its default settings."""
    detector = Detector(DetectionSettings())
    return (*chain.from_iterable(map(detector.feed, blocks)), *detector.finish())


def measurement_topic(bag: Bag, name: str) -> Topic:
    """Return the topic `name`, or without a name that of the first type in USUAL that the bag has.

    Of several topics of that type, the one with the usual name is taken. Raises BagError, which lists the topics of all
    these types, if none or several remain.
    """
    candidates = [topic for kind in USUAL for topic in bag.topics if topic.type == kind and topic.count]
    if not candidates:
        raise BagError(f"{bag.path}: must hold {FORCE_BLOCK} or {IMPACT}, as daq publishes them, or {WRENCH_STAMPED}")
    preferred = [topic for topic in candidates if topic.type == candidates[0].type]
    if name:
        selected = [topic for topic in candidates if topic.name.lstrip("/") == name.lstrip("/")]
    else:
        selected = [topic for topic in preferred if topic.name.lstrip("/") == USUAL[topic.type]] or preferred
    if len(selected) == 1:
        return selected[0]
    problem = f"no force on {name}" if name else "several topics hold the force"
    raise BagError(f"{bag.path}: {problem}; give --force-topic one of {', '.join(topic.name for topic in candidates)}")


def file_measurements(path: Path, settings: ImportSettings, unreadable: Counter[str]) -> Iterator[Measurement]:
    """Yield the measurements in a bag, or the force in a CSV or TDMS file, with the ends of its blocks as log times.

    Raises BagError or SettingsError.
    """
    if path.suffix.lower() in IMPORTERS:
        for block in import_force(path, settings)[1]:
            yield Measurement(block.stamp_ns + round(len(block.force) / block.sample_rate * NS), block)
        return
    with open_bag(path) as bag:
        yield from measurements(bag, measurement_topic(bag, settings.topic), settings, unreadable)


def measurements(bag: Bag, topic: Topic, settings: ImportSettings, unreadable: Counter[str]) -> Iterator[Measurement]:
    """Yield the force blocks or impacts of `topic`; count messages that cannot be decoded in `unreadable`.

    Wrenches are imported as force blocks with `settings`. Raises BagError if the recording has another definition of
    the type, or if wrenches cannot be imported.
    """
    if topic.type in {WRENCH_STAMPED, WRENCH}:
        yield from _import_wrenches(bag, settings.model_copy(update={"topic": topic.name}))
        return
    check_definition(bag.types, topic.type, str(bag.path))
    decode = decode_force_block if topic.type == FORCE_BLOCK else decode_impact
    for message in bag.messages([topic.name]):
        if message.type == topic.type:
            try:
                yield Measurement(message.log_time_ns, decode(message.data))
            except DecodeError as error:
                unreadable[f"{bag.path}: {topic.name}: left out: {error}"] += 1


def _import_wrenches(bag: Bag, settings: ImportSettings) -> Iterator[Measurement]:
    """Yield the force of a topic of wrenches; the log time of the first message places all blocks in log time."""
    first_log_ns = next(message.log_time_ns for message in bag.messages([settings.topic]))
    first_stamp_ns: int | None = None
    _, blocks = import_force(bag.path, settings)
    for block in blocks:
        first_stamp_ns = block.stamp_ns if first_stamp_ns is None else first_stamp_ns
        end_ns = block.stamp_ns + round(len(block.force) / block.sample_rate * NS)
        yield Measurement(first_log_ns + end_ns - first_stamp_ns, block)
