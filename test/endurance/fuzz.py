# SPDX-License-Identifier: Apache-2.0
"""`make fuzz`: random and damaged input through the core, the live node and every file parser; exit 1 on a finding.

A finding is an exception other than EffmassError, a case that takes long, memory that grows, a number that is not
finite, or a permissive answer to input that independent rules call invalid.
"""

from __future__ import annotations

import argparse
import os
import random
import resource
import signal
import subprocess
import sys
import time
from collections import Counter
from contextlib import closing
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
os.environ.setdefault("ROS_DOMAIN_ID", "78")
sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))

import numpy as np
import rclpy
from nptdms import ChannelObject, TdmsWriter
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile
from rich.console import Console
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Ros2Writer
from rosbags.typesys import Stores, get_typestore
from scara_effmass_msgs.msg import ContactStates
from sensor_msgs.msg import JointState as JointStateMessage
from usage import resident_mb

from scara_effmass.analysis.protocol import read_protocol
from scara_effmass.bags.files import open_bag
from scara_effmass.bags.repair import repair
from scara_effmass.errors import DecodeError, EffmassError
from scara_effmass.importers.force import import_force
from scara_effmass.importers.joint_states import write_joint_state_bag
from scara_effmass.model.load import load_robot
from scara_effmass.reference import RobotDynamics
from scara_effmass.safety import Monitor
from scara_effmass.settings import DaqSettings, ImportSettings, MonitorSettings, load_settings
from scara_effmass.settings.loading import checked
from scara_effmass.share import share
from scara_effmass.values import JointState, Verdict
from scara_effmass.wire.joint_state import JointStateDecoder, joint_state_message

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from scara_effmass.values import Decision

NS = 1_000_000_000
MS = NS // 1000
ROOT = Path(__file__).resolve().parents[2]
ODD = (np.nan, np.inf, -np.inf, 1e308, -1e308, 1e9, -7.0, 1e-320, 0.0)
MAX_LENGTH = 6
"""States in a sequence; a sequence starts after a pause, as a new publisher."""
MAX_CASE_S = 20.0
MAX_GROWTH_MB = 300.0
BATCH = 50
HEAD = 60
"""Bytes of a joint state in front of its positions."""
JOINT_STATE = "sensor_msgs/msg/JointState"
STORE = get_typestore(Stores.ROS2_JAZZY)


show = Console(width=140, highlight=False, markup=False).print


def invalid(state: JointState, joints: tuple[str, ...], now_ns: int, last_ns: int, timeout_s: float) -> bool:
    """Return whether a joint state must give UNKNOWN, by rules of this program."""
    values = [*state.position, *state.velocity]
    return (
        state.stamp_ns <= last_ns
        or not -NS < now_ns - state.stamp_ns <= timeout_s * NS
        or any(state.names.count(joint) != 1 for joint in joints)
        or len(state.position) != len(state.names)
        or len(state.velocity) != len(state.names)
        or not np.isfinite(values).all()
        or max(map(abs, values), default=0.0) > 1e3
    )


def mutated(state: JointState, rng: random.Random) -> JointState:
    """Return `state` with one or two faults."""
    names, position, velocity = list(state.names), list(state.position), list(state.velocity)
    stamp_ns = state.stamp_ns
    for _ in range(rng.choice((1, 1, 2))):
        column: list[Any] = rng.choice((names, position, velocity))
        kind = rng.randrange(8)
        if kind < 3:
            column = rng.choice((position, velocity))
            if column:
                column[rng.randrange(len(column))] = rng.choice(ODD)
        elif kind == 3 and column:
            del column[rng.randrange(len(column)) :]
        elif kind == 4 and column:
            column.append(rng.choice(column))
        elif kind == 5 and names:
            names[rng.randrange(len(names))] = rng.choice(("", "joint1", "joint9", "\x00", "é" * 300))
        elif kind == 6:
            stamp_ns = rng.choice((0, -1, stamp_ns - 5 * MS, stamp_ns + 3600 * NS, stamp_ns - NS, 2**62, stamp_ns - MS))
        else:
            rng.shuffle(column)
    return JointState(stamp_ns, tuple(names), np.array(position, float), np.array(velocity, float))


def _wrong(decision: Decision, *, bad: bool) -> Iterator[str]:
    """Yield what is wrong with a decision on a joint state that is `bad` or not."""
    for contact in decision.contacts:
        speeds = (contact.allowable_speed, decision.allowable_speed, decision.speed_scaling)
        if not np.isfinite((*speeds, contact.speed, contact.margin)).all() or min(speeds) < 0.0:
            yield f"not finite: {contact}"
        if contact.verdict is Verdict.UNKNOWN and max(speeds) > 0.0:
            yield f"a speed under UNKNOWN: {contact}"
        if contact.verdict in {Verdict.OK, Verdict.WARN} and contact.speed > contact.allowable_speed:
            yield f"too fast: {contact}"
        if bad and (contact.verdict is not Verdict.UNKNOWN or decision.allowable_speed > 0.0):
            yield f"permissive: {contact}"


def _monitors() -> list[tuple[Monitor, tuple[str, ...]]]:
    """Return monitors of a SCARA, a seven-axis and a six-axis robot, with the names of their joints."""
    choices = {"": {}, "panda.urdf": {"contact_points": ("p=panda_link7: 0 0 0.1",)}, "ur5_robot.urdf": {}}
    monitors = []
    for file, values in choices.items():
        settings = MonitorSettings(release_time=0.0, **values)
        robot = load_robot(share("config", "robots", file) if file else None, settings)
        monitor = Monitor(RobotDynamics(robot), settings)
        monitor.compile()
        monitors.append((monitor, tuple(robot.joint_names)))
    return monitors


def _sequence(
    monitor: Monitor, joints: tuple[str, ...], start_ns: int, rng: random.Random, counts: Counter[str]
) -> Iterator[str]:
    """Yield the findings of one sequence, stamped from `start_ns` on."""
    q = np.array([0.3, 1.2, 0.1, -0.4, 0.2, 0.5, 0.1][: len(joints)]) * rng.choice((1.0, 1.0, -0.3, 9.0))
    qd, last_ns = np.full(len(joints), rng.choice((0.0, 0.01, 0.5))), 0
    for step in range(1, rng.randint(1, MAX_LENGTH) + 1):
        q = q + qd * 1e-3
        state = JointState(start_ns + step * MS, joints, q, qd)
        state = mutated(state, rng) if rng.random() < 0.4 else state
        now_ns = start_ns + step * MS + rng.choice((0, 0, MS, MS, 150 * MS, 300 * MS, -3600 * NS))
        started = time.monotonic()
        try:
            decision = monitor.assess(state, now_ns)
        except Exception as error:  # noqa: BLE001 - a finding
            yield f"{error!r} of {state}"
            return
        counts["states"] += 1
        if time.monotonic() - started > MAX_CASE_S:
            yield f"took {time.monotonic() - started:.0f} s: {state}"
        last_ns = 0 if last_ns > now_ns + NS else last_ns  # the clock was set back, and stamps may follow
        bad = invalid(state, joints, now_ns, last_ns, monitor.settings.timeout)
        last_ns = last_ns if bad else state.stamp_ns
        if decision is not None:
            counts.update(contact.verdict.name for contact in decision.contacts)
            yield from (f"{text} of {state} at {now_ns}" for text in _wrong(decision, bad=bad))


def core(count: int, seed: int) -> list[str]:
    """Feed `count` sequences of 1 to 6 joint states to the core; return the findings."""
    rng, monitors, counts, findings = random.Random(seed), _monitors(), Counter[str](), []
    before_mb = resident_mb(os.getpid())
    for number in range(count):
        monitor, joints = monitors[number % len(monitors)]
        monitor.clear_history()
        monitor.reset()
        texts = _sequence(monitor, joints, (1_700_000_000 + number) * NS, rng, counts)
        findings += [f"core, sequence {number}: {text}" for text in texts]
    findings += _growth("core", before_mb, resident_mb(os.getpid()))
    findings += [f"core: {monitor.kernel_fault}" for monitor, _ in monitors if monitor.kernel_fault]
    show(f"core: {count} sequences of 1 to {MAX_LENGTH}: {dict(counts)}, {len(findings)} findings")
    return findings


def _growth(what: str, before_mb: float, after_mb: float) -> list[str]:
    show(f"{what}: memory {after_mb - before_mb:+.0f} MB")
    return [f"{what}: memory grew by {after_mb - before_mb:.0f} MB"] * (after_mb - before_mb > MAX_GROWTH_MB)


def damaged(data: bytes, rng: random.Random, snippets: tuple[bytes, ...] = (), limit: int = 2**62) -> bytes:
    """Return `data` with a few of its first `limit` bytes flipped, replaced, removed, repeated or added, or cut off."""
    out = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 4))):
        at, size = rng.randrange(min(limit, len(out) + 1)), rng.choice((1, 2, 4, 8, 40))
        kind = rng.randrange(7)
        if kind == 0 and at < len(out):
            out[at] ^= 1 << rng.randrange(8)
        elif kind == 1:
            out[at : at + size] = rng.randbytes(size)
        elif kind == 2:
            del out[at : at + size]
        elif kind == 3:
            out[at:at] = out[at : at + size * 8]
        elif kind == 4:
            del out[at:]
        elif kind == 5:
            out[at : at + 4] = rng.choice(
                (b"\xff\xff\xff\xff", b"\x00\x00\x00\x00", b"\x00\x00\x00\x7f", b"\x01\x00\x00\x00")
            )
        elif snippets:
            out[at : at + rng.randrange(size)] = rng.choice(snippets)
    return bytes(out)


def _decoded(data: bytes) -> JointState | None:
    try:
        message: Any = STORE.deserialize_cdr(data, JOINT_STATE)
    except Exception:  # noqa: BLE001 - rosbags raises many kinds for malformed bytes
        try:  # rosbags refuses a broken frame_id and a longer end, which say nothing about the joints
            return JointStateDecoder().decode(data)
        except DecodeError:
            return None
    stamp = message.header.stamp
    return JointState(stamp.sec * NS + stamp.nanosec, tuple(message.name), message.position, message.velocity)


class Cell:
    """A live monitor in a process, and a node that sends to it."""

    joints = ("joint1", "joint2", "joint3", "joint4")

    def __init__(self) -> None:
        command = [str(Path(sys.executable).with_name("monitor_node")), "--ros-args", "--log-level", "fatal"]
        command += ["-p", "release_time:=0.0", "-p", "timeout:=60.0", "-p", "contact_points:=['tool']"]
        self.process = subprocess.Popen(command)
        rclpy.init()
        self.node = rclpy.create_node("fuzz")
        self.publisher = self.node.create_publisher(JointStateMessage, "joint_states", QoSProfile(depth=1000))
        self.node.create_subscription(ContactStates, "contact_states", self._on_answer, QoSProfile(depth=5000))
        self.answers: list[tuple[int, Verdict]] = []
        """Stamp [ns] and verdict."""
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)
        self._start_ns = time.time_ns()
        self._spin_until(
            lambda: self.publisher.get_subscription_count() and self.node.count_publishers("contact_states")
        )

    def close(self) -> None:
        """End the monitor."""
        self.node.destroy_node()
        rclpy.shutdown()
        self.process.send_signal(signal.SIGINT)
        self.process.wait(MAX_CASE_S)

    def state(self, stamp_ns: int) -> bytes:
        """Return a valid joint state of a slow motion."""
        q = np.array([0.3, 1.2, 0.1, -0.4]) + 0.004 * (stamp_ns - self._start_ns) / NS
        return joint_state_message(JointState(stamp_ns, self.joints, q, np.full(4, 0.004)))

    def exchange(self, messages: list[bytes]) -> tuple[list[tuple[int, Verdict]], set[int]]:
        """Send `messages` and a valid one; return the answers and the stamps of valid ones. Raises RuntimeError."""
        for data in messages:
            self.publisher.publish(data)
        sent: set[int] = set()

        def send() -> None:
            sent.add(stamp_ns := time.time_ns())
            self.publisher.publish(self.state(stamp_ns))

        self._spin_until(lambda: sent & {stamp_ns for stamp_ns, _ in self.answers}, send)
        answers, self.answers = self.answers, []
        return answers, sent

    def _on_answer(self, state: ContactStates) -> None:
        stamp_ns = state.header.stamp.sec * NS + state.header.stamp.nanosec
        self.answers.append((stamp_ns, Verdict(state.verdict)))

    def _spin_until(self, done: Callable[[], object], repeat: Callable[[], None] = lambda: None) -> None:
        """Spin until `done`; call `repeat` at once and every second, because best effort may lose a message."""
        start = again = time.monotonic()
        while not done():
            if time.monotonic() >= again:
                repeat()
                again += 1.0
            self._executor.spin_once(timeout_sec=0.2)
            if self.process.poll() is not None or time.monotonic() > start + 2 * MAX_CASE_S:
                raise RuntimeError(f"no answer: exit status {self.process.poll()}")


def _batch(cell: Cell, rng: random.Random, limit: int) -> tuple[list[bytes], set[int]]:
    """Return damaged joint states between valid ones, and the stamps that may have a permissive answer."""
    messages, allowed = [], set[int]()
    for _ in range(BATCH):
        if rng.random() < 0.5:
            allowed.add(stamp_ns := time.time_ns())
            messages.append(cell.state(stamp_ns))
        messages.append(data := damaged(cell.state(time.time_ns()), rng, limit=limit))
        state = _decoded(data + bytes(-len(data) % 4))  # as Fast DDS pads them
        if state is not None and not invalid(state, cell.joints, time.time_ns(), 0, 60.0):
            allowed.add(state.stamp_ns)
    return messages, allowed


def node(count: int, seed: int) -> list[str]:
    """Send `count` damaged joint states to a live monitor over DDS; return the findings."""
    rng, counts, findings = random.Random(seed), Counter[str](), []
    with closing(Cell()) as cell:
        cell.exchange([])
        before_mb = resident_mb(cell.process.pid)
        for batch in range(count // BATCH):
            # Positions that jump keep the answers of a batch UNKNOWN.
            messages, allowed = _batch(cell, rng, 2**62 if batch % 10 == 9 else HEAD)
            try:
                answers, valid = cell.exchange(messages)
            except RuntimeError as error:
                findings.append(f"node: {error} after {[data.hex() for data in messages]}")
                break
            for stamp_ns, verdict in answers:
                counts[verdict.name] += 1
                if verdict in {Verdict.OK, Verdict.WARN} and stamp_ns not in allowed | valid:
                    findings.append(f"node: permissive at {stamp_ns}: {[data.hex() for data in messages]}")
        else:
            findings += _growth("node", before_mb, resident_mb(cell.process.pid))
    show(f"node: {count} damaged messages, answers {dict(counts)}, {len(findings)} findings")
    return findings


def _read_all(path: Path) -> None:
    bag = open_bag(path)
    try:
        for _ in bag.messages():
            pass
        for topic in bag.joint_state_topics:
            for _ in bag.joint_state_blocks(topic):
                pass
    finally:
        bag.close()


def parsers(folder: Path) -> dict[str, tuple[str, bytes, Callable[[Path], object]]]:
    """Return for each parser the name of its file, a valid content and the call."""
    mapping = folder / "map.yaml"
    mapping.write_text("time: t\njoints:\n  joint1: {position: q1, velocity: v1}\n", encoding="utf-8")
    with TdmsWriter(folder / "seed.tdms") as writer:
        force = np.linspace(0.0, 50.0, 200)
        writer.write_segment([ChannelObject("g", "c", force, {"wf_increment": 1e-3, "unit_string": "N"})])
    with Ros2Writer(folder / "seed", version=9, storage_plugin=StoragePlugin.SQLITE3) as bag:
        topic = bag.add_connection("/joint_states", JOINT_STATE, typestore=STORE)
        for i in range(20):
            state = JointState(NS + i * MS, ("joint1",), np.zeros(1), np.zeros(1))
            bag.write(topic, NS + i * MS, joint_state_message(state))
    table = "t,q1,v1\n" + "".join(f"{0.001 * i:.3f},{0.1 * i:.3f},100.0\n" for i in range(40))
    force_table = "time [s],force [N]\n" + "".join(f"{0.001 * i:.3f},{0.1 * i:.3f}\n" for i in range(60))

    def shared(*parts: str) -> bytes:
        return share(*parts).read_bytes()

    def joint_table(path: Path) -> None:
        write_joint_state_bag(path, mapping, folder / "out", overwrite=True)

    def joint_map(path: Path) -> None:
        entries = path.read_text(encoding="utf-8", errors="replace").splitlines()
        settings = checked(
            MonitorSettings, {"joint_map": tuple(entries[:1]), "joint_limits": tuple(entries[1:])}, "map"
        )
        Monitor(RobotDynamics(load_robot(settings=settings)), settings)

    return {
        "robot, DH YAML": ("r.yaml", shared("config", "omron_i4_550l.yaml"), load_robot),
        "robot, URDF": ("r.urdf", shared("config", "robots", "ur5_robot.urdf"), load_robot),
        "parameters, monitor": (
            "p.yaml",
            shared("config", "monitor.yaml"),
            lambda path: load_settings(MonitorSettings, path, "monitor"),
        ),
        "parameters, daq": (
            "p.yaml",
            shared("config", "daq.yaml"),
            lambda path: load_settings(DaqSettings, path, "daq"),
        ),
        "joint map, limits": ("m.txt", b"left_*=*\njoint1=-1 1", joint_map),
        "mapping of joint columns": (
            "map2.yaml",
            mapping.read_bytes(),
            lambda path: write_joint_state_bag(folder / "seed.csv", path, folder / "out", overwrite=True),
        ),
        "joint states, CSV": ("seed.csv", table.encode(), joint_table),
        "force, CSV": ("f.csv", force_table.encode(), lambda path: list(import_force(path, ImportSettings())[1])),
        "force, TDMS": (
            "f.tdms",
            (folder / "seed.tdms").read_bytes(),
            lambda path: list(import_force(path, ImportSettings())[1]),
        ),
        "protocol": ("q.yaml", _protocol(folder), read_protocol),
        "bag, MCAP": ("b.mcap", _mcap(folder), _read_all),
        "repair, MCAP": ("c.mcap", _mcap(folder), repair),
        "bag, SQLite": ("b.db3", next((folder / "seed").glob("*.db3")).read_bytes(), _read_all),
        "bag, ROS 1": ("b.bag", (ROOT / "test/recordings/interbotix_wx200_waist.bag").read_bytes(), _read_all),
    }


def _protocol(folder: Path) -> bytes:
    path = folder / "protocol.yaml"
    command = [sys.executable, "-m", "scara_effmass", "protocol", "init", "-o", str(path)]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return path.read_bytes()


def _mcap(folder: Path) -> bytes:
    output = folder / "mcap"
    (folder / "seed.csv").write_text(
        "t,q1,v1\n" + "".join(f"{0.001 * i:.3f},{0.1 * i:.3f},100.0\n" for i in range(40)), encoding="utf-8"
    )
    write_joint_state_bag(folder / "seed.csv", folder / "map.yaml", output, overwrite=True)
    return next(output.glob("*.mcap")).read_bytes()


SNIPPETS = (
    b"\x00",
    b"\xff\xfe",
    b"[" * 500,
    b"{a: " * 300,
    b"&a [*a]",
    b"<<: 1",
    b".nan",
    b".inf",
    b"1e5000",
    b"-1e308",
    b"9" * 5000,
    b"2001-99-99",
    b"<a>" * 500,
    b"&bomb;",
    b"<!DOCTYPE x>",
    b"nan",
    b"\r\n",
    b'"',
    b"1,5;2",
    b"\t",
)


def files(count: int, seed: int) -> list[str]:
    """Read `count` damaged files with each parser; return the findings."""
    findings = []

    def too_long(*_: object) -> None:
        raise TimeoutError

    signal.signal(signal.SIGALRM, too_long)
    with TemporaryDirectory() as name:
        for parser, (file, content, read) in parsers(Path(name)).items():
            rng, refused, kinds = random.Random(f"{seed} {parser}"), 0, set[str]()
            path, before_mb = Path(name, f"x{file}"), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
            for case in range(count):
                path.write_bytes(damaged(content, rng, SNIPPETS))
                signal.alarm(round(MAX_CASE_S))
                try:
                    read(path)
                except EffmassError:
                    refused += 1
                except Exception as error:  # noqa: BLE001 - a finding
                    kind = f"{type(error).__name__}: {str(error)[:60]}"
                    if kind not in kinds:
                        kinds.add(kind)
                        kept = Path("build", f"fuzz_{parser.replace(' ', '_')}_{case}{path.suffix}")
                        kept.parent.mkdir(exist_ok=True)
                        kept.write_bytes(path.read_bytes())
                        findings.append(f"{parser}, case {case}: {error!r}: {kept}")
                finally:
                    signal.alarm(0)
            growth = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3 - before_mb
            if growth > MAX_GROWTH_MB:
                findings.append(f"{parser}: peak memory grew by {growth:.0f} MB")
            show(
                f"{parser}: {count} damaged files, {refused} refused, {len(kinds)} kinds of crash, {growth:+.0f} MB",
            )
    return findings


def main() -> int:
    """Run the parts and print the findings."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("parts", nargs="*", default=("core", "node", "files"))
    parser.add_argument(
        "--number", type=int, default=1_000_000, help="sequences; a tenth messages, a 500th of each file"
    )
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    findings = []
    for part in args.parts:
        run, share_of = {"core": (core, 1), "node": (node, 10), "files": (files, 500)}[part]
        findings += run(max(1, args.number // share_of), args.seed)
    show("\n".join((*findings[:50], f"{len(findings)} findings")))
    return bool(findings)


if __name__ == "__main__":
    sys.exit(main())
