"""Kill the recorder with SIGKILL at random moments, and see what is left of its recordings.

Each run records in a process of its own, which tells after every few messages how many are known to be in the files.
After the kill every file must be readable with at least those messages, in order and byte by byte; and `repair` must
make of it a recording that the indexed readers of mcap and rosbags take.

    python benchmarks/kill_recorder.py [--runs 100] [--seed 1] [--json]
"""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import struct
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, NoReturn

import numpy as np
import yaml
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from scara_effmass.bags.definitions import known_types
from scara_effmass.bags.files import open_bag
from scara_effmass.bags.recorder import BagRecorder, RecorderOptions
from scara_effmass.bags.repair import repair
from scara_effmass.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Callable

STRING = "std_msgs/msg/String"
TOPICS = ("/few", "/many")
FLUSH_S = 0.02
LONGEST_S = 0.6
BURST = 20
PAUSE_S = 0.001
TOLD = struct.Struct("<Q")


class Outcome(NamedTuple):
    """What one kill left: messages told to be saved, found, and found after the repair; and how it went."""

    after_s: float
    told: int
    found: int
    repaired: int
    parts: int
    age_s: float
    """From the last message that was found to the kill."""


def measure(runs: int = 100, seed: int = 1, progress: Callable[[int], None] = lambda _: None) -> list[Outcome]:
    """Return the outcome of every run. Raises RuntimeError when a recording is not as it must be."""
    known_types()  # here, so that the processes of the runs begin with it
    generator = random.Random(seed)  # noqa: S311 - no secret
    outcomes = []
    for number in range(runs):
        with tempfile.TemporaryDirectory() as folder:
            outcomes.append(_run(Path(folder) / "bag", generator))
        progress(number + 1)
    return outcomes


def message(topic: int, number: int) -> bytes:
    """Return message `number` of a topic, CDR of a std_msgs/String, of a length that varies."""
    text = f"{topic} {number} ".encode() + b"." * (number * 7919 % (40 if topic else 3000)) + b"\0"
    return b"\x00\x01\x00\x00" + struct.pack("<I", len(text)) + text


def _run(bag: Path, generator: random.Random) -> Outcome:
    options = RecorderOptions(
        compress=generator.random() < 0.7,
        max_file_bytes=generator.choice((0, 20_000, 200_000)),
        flush_period_s=FLUSH_S,
        reserve_bytes=0,
        warn_bytes=0,
        warn_before_s=0.0,
    )
    after_s = generator.uniform(0.0, LONGEST_S)
    receive, send = os.pipe()
    process = os.fork()
    if not process:
        _record(bag, options, send)
    os.close(send)
    time.sleep(after_s)
    killed_ns = time.time_ns()
    os.kill(process, signal.SIGKILL)
    os.waitpid(process, 0)
    with os.fdopen(receive, "rb") as pipe:
        said = pipe.read()
    told = TOLD.unpack_from(said, len(said) // TOLD.size * TOLD.size - TOLD.size)[0] if len(said) >= TOLD.size else 0
    return _checked(bag, after_s, killed_ns, told)


def _record(bag: Path, options: RecorderOptions, send: int) -> NoReturn:
    """Record until killed, in the process of the run."""
    try:
        recording = BagRecorder(bag, options)
        numbers = [recording.add_topic(topic, STRING) for topic in TOPICS]
        count = 0
        while True:
            for _ in range(BURST):
                for topic in numbers[count % 10 != 0 :]:  # every tenth message of the one is beside one of the other
                    number = count // 10 if topic == 0 else count
                    recording.write(topic, time.time_ns(), message(topic, number))
                count += 1
            os.write(send, TOLD.pack(recording.report().saved))
            time.sleep(PAUSE_S)
    finally:
        os._exit(1)


def _checked(bag: Path, after_s: float, killed_ns: int, told: int) -> Outcome:
    found, last_ns = _found(bag) if bag.exists() else (0, 0)
    _require(found >= told, f"{found} messages are there, {told} were saved")
    age_s = (killed_ns - last_ns) / 1e9 if found else 0.0
    if not bag.exists():
        return Outcome(after_s, told, 0, 0, 0, 0.0)
    report = repair(bag)
    _require(not report.failed and not any(file.kept_original for file in report.files), f"{report}")
    kept = sum(file.messages for file in report.files)
    _require(kept == found, f"{found} messages were there, {kept} after the repair")
    indexed = 0
    for file in report.files:
        with file.path.open("rb") as opened:
            reader = make_reader(opened, validate_crcs=True)
            summary = reader.get_summary()
            _require(summary is not None and summary.statistics is not None, f"{file.path}: no summary")
            indexed += sum(1 for _ in reader.iter_messages())
    _require(indexed == found, f"mcap reads {indexed} of {found} messages")
    with AnyReader([bag]) as reader:
        counts = dict.fromkeys(TOPICS, 0)
        for connection, _, data in reader.messages():
            topic = TOPICS.index(connection.topic)
            _require(data == message(topic, counts[connection.topic]), f"{connection.topic}: another message")
            counts[connection.topic] += 1
    _require(sum(counts.values()) == found, f"rosbags reads {sum(counts.values())} of {found} messages")
    about = yaml.safe_load((bag / "metadata.yaml").read_text(encoding="utf-8"))["rosbag2_bagfile_information"]
    _require(about["message_count"] == found, f"metadata.yaml says {about['message_count']} of {found} messages")
    _require(repair(bag).intact, "a second repair finds something to do")
    return Outcome(after_s, told, found, kept, len(report.files), age_s)


def _found(bag: Path) -> tuple[int, int]:
    """Return how many messages can be read as they are, and the last log time; all in order, byte by byte."""
    counts, last_ns = [0, 0], 0
    try:
        opened = open_bag(bag)
    except BagError as error:
        _require("no message of it can be read" in str(error), str(error))
        return 0, 0
    with opened:
        for raw in opened.messages():
            topic = TOPICS.index(raw.topic)
            _require(raw.data == message(topic, counts[topic]), f"{raw.topic}: another message than {counts[topic]}")
            counts[topic] += 1
            last_ns = raw.log_time_ns
    return sum(counts), last_ns


def _require(fulfilled: bool, otherwise: str) -> None:  # noqa: FBT001 - a condition
    if not fulfilled:
        raise RuntimeError(otherwise)


def main() -> None:
    """Run, and print what came of it."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    outcomes = measure(args.runs, args.seed)
    ages = [outcome.age_s for outcome in outcomes if outcome.found] or [0.0]
    result = {
        "runs": len(outcomes),
        "without a message yet": sum(not outcome.found for outcome in outcomes),
        "messages found": sum(outcome.found for outcome in outcomes),
        "messages told to be saved": sum(outcome.told for outcome in outcomes),
        "parts": sum(outcome.parts for outcome in outcomes),
        "age of the last message found, median [s]": float(np.median(ages)),
        "age of the last message found, worst [s]": max(ages),
    }
    lines = json.dumps(result) if args.json else "\n".join(f"{key}: {value}" for key, value in result.items())
    sys.stdout.write(f"{lines}\n")


if __name__ == "__main__":
    main()
