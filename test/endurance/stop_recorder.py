# SPDX-License-Identifier: Apache-2.0
"""Stop the recorder under load again and again: it goes on each time, and what got lost is counted.

A stop makes the middleware drop messages while Python's lock is held. A recorder that took the event of a lost message
stood still for ever within two to a hundred such stops.

    python test/endurance/stop_recorder.py [--stops 100] [--stop-s 0.25] [--rate 8000] [--json]
"""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import rclpy
from rclpy.qos import QoSProfile
from std_msgs.msg import String

from scara_effmass.bags.files import open_bag

TOPICS = 4
GROWTH_TIMEOUT_S = 15.0
END_TIMEOUT_S = 60.0
PAUSE_S = (0.05, 0.5)
PERIOD_S = 0.01


class Load(threading.Thread):
    """Publishes numbered texts at `rate` messages/s over all topics until `stop` is set."""

    def __init__(self, rate: float) -> None:
        super().__init__(daemon=True)
        self.stop = threading.Event()
        self.published = 0
        self._rate = rate
        rclpy.init()
        node = rclpy.create_node("load")
        qos = QoSProfile(depth=100)
        self._publishers = [node.create_publisher(String, f"/load{number}", qos) for number in range(TOPICS)]

    def run(self) -> None:
        """Publish in bursts, one each 10 ms."""
        message = String(data="x" * 100)
        due_s = time.monotonic()
        burst = max(1, round(self._rate * PERIOD_S / TOPICS))
        while not self.stop.is_set():
            for publisher in self._publishers:
                for _ in range(burst):
                    publisher.publish(message)
            self.published += burst * TOPICS
            due_s = max(due_s + PERIOD_S, time.monotonic() - 1.0)
            time.sleep(max(0.0, due_s - time.monotonic()))


def size_of(bag: Path) -> int:
    """Return the size [B] of what is recorded."""
    return sum(file.stat().st_size for file in bag.glob("*.mcap"))


def await_growth(bag: Path, process: subprocess.Popen[str], size: int) -> None:
    """Wait until the bag is larger than `size`. Raises RuntimeError if that takes too long."""
    end_s = time.monotonic() + GROWTH_TIMEOUT_S
    while size_of(bag) <= size:
        if process.poll() is not None:
            raise RuntimeError(f"the recorder has ended: {process.returncode}")
        if time.monotonic() > end_s:
            raise RuntimeError(f"the recorder has written nothing for {GROWTH_TIMEOUT_S:g} s")
        time.sleep(0.02)


def measure(stops: int, stop_s: float, rate: float) -> dict[str, Any]:
    """Return counts of the campaign. Raises RuntimeError if the recorder stands still or its counts are wrong."""
    generator = random.Random(1)  # noqa: S311 - no secret
    load = Load(rate)
    load.start()
    begin_s = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / "bag"
        topics = [f"/load{number}" for number in range(TOPICS)]
        command = [sys.executable, "-m", "scara_effmass", "record", "-o", str(bag), "--json", *topics]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        try:
            await_growth(bag, process, 10_000)
            for _ in range(stops):
                os.kill(process.pid, signal.SIGSTOP)
                time.sleep(stop_s)
                size = size_of(bag)
                os.kill(process.pid, signal.SIGCONT)
                await_growth(bag, process, size)
                time.sleep(generator.uniform(*PAUSE_S))
            seconds = time.monotonic() - begin_s
            load.stop.set()
            load.join()
            process.send_signal(signal.SIGINT)
            output, errors = process.communicate(timeout=END_TIMEOUT_S)
        finally:
            process.kill()
        report = json.loads(output)
        with open_bag(bag) as recorded:
            counts = {topic.name: topic.count for topic in recorded.topics}
        if sum(counts.values()) != report["messages"]:
            raise RuntimeError(f"the bag has {counts}, the report {report['messages']}")
    if report["messages"] + report["lost"] > load.published:
        raise RuntimeError(f"{report['messages']} recorded, {report['lost']} lost, {load.published} published")
    return {
        "stops": stops,
        "seconds": seconds,
        "rate": load.published / seconds,
        "published": load.published,
        "recorded": report["messages"],
        "lost": report["lost"],
        "exit_status": process.returncode,
        "stderr": errors,
    }


def main() -> int:
    """Run the campaign and print its counts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--stops", type=int, default=100)
    parser.add_argument("--stop-s", type=float, default=0.25)
    parser.add_argument("--rate", type=float, default=8000.0)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    result = measure(args.stops, args.stop_s, args.rate)
    if args.json:
        print(json.dumps(result))  # noqa: T201
    else:
        print(  # noqa: T201
            f"{result['stops']} stops in {result['seconds']:.0f} s at {result['rate']:.0f} messages/s: "
            f"{result['recorded']} recorded, {result['lost']} lost and counted of {result['published']}"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
