# SPDX-License-Identifier: Apache-2.0
"""Kill the recorder with SIGKILL at random moments and check its bags.

Each run records in its own process, which reports after every few messages how many are saved. After the kill, all
saved messages must be readable, in order and unchanged, and after `repair` mcap and rosbags must read them by index.

    python test/endurance/kill_recorder.py [--runs 100] [--seed 1] [--json]
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
MAX_RUN_S = 0.6
BURST = 20
PAUSE_S = 0.001
SAVED_COUNT = struct.Struct("<Q")


class Outcome(NamedTuple):
    """Result of one run: messages reported as saved, read, and read after the repair."""

    after_s: float
    saved: int
    readable: int
    repaired: int
    files: int
    age_s: float
    """Time from the last readable message to the kill."""


def measure(runs: int = 100, seed: int = 1, progress: Callable[[int], None] = lambda _: None) -> list[Outcome]:
    """Return the outcome of every run. Raises RuntimeError if a bag is not as required."""
    known_types()  # cached before the fork
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
    after_s = generator.uniform(0.0, MAX_RUN_S)
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
        reports = pipe.read()
    complete = len(reports) // SAVED_COUNT.size
    saved = SAVED_COUNT.unpack_from(reports, (complete - 1) * SAVED_COUNT.size)[0] if complete else 0
    return _check(bag, after_s, killed_ns, saved)


def _record(bag: Path, options: RecorderOptions, send: int) -> NoReturn:
    """Record until killed, in the forked process."""
    try:
        recorder = BagRecorder(bag, options)
        topics = [recorder.add_topic(topic, STRING) for topic in TOPICS]
        count = 0
        while True:
            for _ in range(BURST):
                for topic in topics[count % 10 != 0 :]:  # one message of the first topic for ten of the second
                    number = count // 10 if topic == 0 else count
                    recorder.write(topic, time.time_ns(), message(topic, number))
                count += 1
            os.write(send, SAVED_COUNT.pack(recorder.report().saved))
            time.sleep(PAUSE_S)
    finally:
        os._exit(1)


def _check(bag: Path, after_s: float, killed_ns: int, saved: int) -> Outcome:
    readable, last_ns = _read(bag) if bag.exists() else (0, 0)
    _require(readable >= saved, f"{readable} messages are readable, {saved} were saved")
    age_s = (killed_ns - last_ns) / 1e9 if readable else 0.0
    if not bag.exists():
        return Outcome(after_s, saved, 0, 0, 0, 0.0)
    report = repair(bag)
    _require(not report.failed and not any(file.kept_original for file in report.files), f"{report}")
    kept = sum(file.messages for file in report.files)
    _require(kept == readable, f"{readable} messages before the repair, {kept} after it")
    indexed = 0
    for file in report.files:
        with file.path.open("rb") as opened:
            reader = make_reader(opened, validate_crcs=True)
            summary = reader.get_summary()
            _require(summary is not None and summary.statistics is not None, f"{file.path}: no summary")
            indexed += sum(1 for _ in reader.iter_messages())
    _require(indexed == readable, f"mcap reads {indexed} of {readable} messages")
    with AnyReader([bag]) as rosbag:
        counts = dict.fromkeys(TOPICS, 0)
        for connection, _, data in rosbag.messages():
            topic = TOPICS.index(connection.topic)
            _require(data == message(topic, counts[connection.topic]), f"{connection.topic}: a message differs")
            counts[connection.topic] += 1
    _require(sum(counts.values()) == readable, f"rosbags reads {sum(counts.values())} of {readable} messages")
    metadata = yaml.safe_load((bag / "metadata.yaml").read_text(encoding="utf-8"))
    listed = metadata["rosbag2_bagfile_information"]["message_count"]
    _require(listed == readable, f"metadata.yaml lists {listed} of {readable} messages")
    _require(repair(bag).intact, "a second repair changes the bag")
    return Outcome(after_s, saved, readable, kept, len(report.files), age_s)


def _read(bag: Path) -> tuple[int, int]:
    """Return the number of readable messages, checked for order and content, and the last log time."""
    counts, last_ns = [0, 0], 0
    try:
        opened = open_bag(bag)
    except BagError as error:
        _require("no message can be read" in str(error), str(error))
        return 0, 0
    with opened:
        for raw in opened.messages():
            topic = TOPICS.index(raw.topic)
            _require(raw.data == message(topic, counts[topic]), f"{raw.topic}: message {counts[topic]} differs")
            counts[topic] += 1
            last_ns = raw.log_time_ns
    return sum(counts), last_ns


def _require(condition: bool, failure: str) -> None:  # noqa: FBT001 - a condition
    if not condition:
        raise RuntimeError(failure)


def main() -> None:
    """Run and print the totals."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    outcomes = measure(args.runs, args.seed)
    ages = [outcome.age_s for outcome in outcomes if outcome.readable] or [0.0]
    result = {
        "runs": len(outcomes),
        "without a message yet": sum(not outcome.readable for outcome in outcomes),
        "messages readable": sum(outcome.readable for outcome in outcomes),
        "messages reported as saved": sum(outcome.saved for outcome in outcomes),
        "files": sum(outcome.files for outcome in outcomes),
        "age of the last readable message, median [s]": float(np.median(ages)),
        "age of the last readable message, worst [s]": max(ages),
    }
    lines = json.dumps(result) if args.json else "\n".join(f"{key}: {value}" for key, value in result.items())
    sys.stdout.write(f"{lines}\n")


if __name__ == "__main__":
    main()
