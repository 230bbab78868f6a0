"""`scara-effmass demo`."""

from __future__ import annotations

import json
import math
import shutil
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from scara_effmass.cli.live import StatusLine
from scara_effmass.cli.options import (
    add_force,
    add_json,
    add_params,
    add_robot,
    add_topic,
    arm_from,
    printer,
    settings_from,
)
from scara_effmass.cli.processes import child_process, keep_to_this_machine, require_running
from scara_effmass.cli.report import summary_lines
from scara_effmass.errors import EffmassError, SettingsError
from scara_effmass.settings import MassModel

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator, Mapping

    from rich.console import Console

    from scara_effmass.analysis.forces import Forces
    from scara_effmass.analysis.summary import Summary
    from scara_effmass.analysis.trace import Trace
    from scara_effmass.bags.bag import Bag
    from scara_effmass.model.dynamics import RobotDynamics
    from scara_effmass.nodes.monitor_client import MonitorClient
    from scara_effmass.settings import MonitorSettings
    from scara_effmass.values import ContactAssessment

EXAMPLES = """\
Without --bag: a simulated robot drives into simulated carts, live; monitor, force and validator nodes watch it over
DDS, the recorder records it, and a report tells how well the predicted forces agree. Takes about a minute.

With --bag: the recording is replayed to the monitor, its force (if it holds any) is played by the force node, the run
is recorded, and a summary and a figure are made.

Everything runs as processes of its own, in a ROS domain of its own on this machine.

examples:
  scara-effmass demo
  scara-effmass demo --bag bags/tour --rate 2 --duration 10 --out out/tour
  scara-effmass demo --bag recording.bag --robot arm.urdf --topic /arm/joint_states --out out/arm
"""

START_WITHIN_S = 60.0
STRAGGLERS_S = 10.0
"""How long after the end of the replay the last answers may take."""
FORCE_ENDS_WITHIN_S = 3.0
SUMMARY = "summary.json"
FIGURE = "run"
BAG = "recording"
SIMULATED_TIME = ["--ros-args", "-p", "use_sim_time:=true"]


class Recording(NamedTuple):
    """What is replayed: its topics, the time that is replayed, and what it says of its making."""

    path: Path
    topic: str
    force_topic: str
    """empty where it holds no force"""
    span_s: float
    made: str


def add_to(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.epilog = EXAMPLES
    parser.add_argument(
        "--bag", type=Path, metavar="BAG", help="recording to replay (default: the simulated cell, live)"
    )
    add_topic(parser)
    add_robot(parser)
    add_params(parser)
    parser.add_argument(
        "--rate", type=float, default=1.0, help="times the original speed; 0: as fast as the monitor answers"
    )
    parser.add_argument(
        "--duration", type=float, default=math.inf, metavar="S", help="how much to replay or simulate [s]"
    )
    parser.add_argument(
        "--out", type=Path, default=Path("out/demo"), metavar="DIR", help="where recording, figures and summary go"
    )
    add_force(parser)
    add_json(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run it live, then summarise and draw."""
    from scara_effmass.analysis.figure import FORMATS  # noqa: PLC0415 - not needed for --help
    from scara_effmass.analysis.output import require_free  # noqa: PLC0415
    from scara_effmass.bags.rosbag2 import refuse_existing  # noqa: PLC0415

    refuse_existing(args.out / BAG, overwrite=args.force)
    settings, arm, choice = _settled(args)
    console = printer()
    if args.bag is None:
        return _run_bench(args, settings, arm, console)
    for name in (SUMMARY, *(f"{FIGURE}{suffix}" for suffix in FORMATS)):
        require_free(args.out / name, overwrite=args.force)
    recording = _recording(args)
    live = Live(arm, settings)
    if not args.json:
        for subject, text in _introduction(recording, arm, settings, choice, args.rate):
            console.print(f"{subject:<16}{text}")
    with _all_or_nothing(args.out):
        live.run(args, settings, recording, console)
    if not live.cycles:
        raise EffmassError(
            f"{recording.path}: the monitor answered none of {live.sent} joint states; does {arm.robot.name} fit?"
        )
    _finish(args, live, recording, arm, settings, console)
    return 0


def _run_bench(args: argparse.Namespace, settings: MonitorSettings, arm: RobotDynamics, console: Console) -> int:
    from scara_effmass.cli.demo_bench import run_bench  # noqa: PLC0415

    if args.robot or settings.robot:
        raise SettingsError("demo: --robot: the simulated cell is an i4-550L; --bag replays another robot's motion")
    if args.topic:
        raise SettingsError(f"demo: --topic = {args.topic}: the simulated cell has its own; it goes with --bag")
    with _all_or_nothing(args.out):
        return run_bench(args, arm, settings, console)


@contextmanager
def _all_or_nothing(folder: Path) -> Iterator[None]:
    """Leave no recording of a demo that did not come to its end."""
    try:
        yield
    except BaseException:
        shutil.rmtree(folder / BAG, ignore_errors=True)
        raise


class Live:
    """One run through the live monitor, and what came of it."""

    def __init__(self, arm: RobotDynamics, settings: MonitorSettings) -> None:
        """Prepare for the contact points of `arm`."""
        from scara_effmass.analysis.summary import Summary  # noqa: PLC0415
        from scara_effmass.analysis.trace import Trace  # noqa: PLC0415

        self._joints = frozenset(arm.robot.joint_names)
        self.summary: Summary = Summary(round(settings.timeout * 1e9))
        self.traces: dict[str, Trace] = {name: Trace() for name in arm.contact_points}
        self.sent = self.cycles = self.silences = self.foreign = 0
        self.replayed: dict[str, Any] = {}
        self.recorded: dict[str, Any] = {}
        self._first_ns: int | None = None

    @property
    def lost(self) -> int:
        """Joint states sent, of this robot's, that were not answered."""
        return self.sent - self.foreign - self.cycles

    def run(self, args: argparse.Namespace, settings: MonitorSettings, recording: Recording, console: Console) -> None:
        """Start everything, and receive until the end. Raises EffmassError when a part of it fails."""
        keep_to_this_machine()
        from scara_effmass.nodes.monitor_client import MonitorClient  # noqa: PLC0415 - reads the domain when it is made

        with ExitStack() as running:
            monitor = running.enter_context(child_process(monitor_words(args, settings)))
            force = running.enter_context(child_process(_force_words(recording))) if recording.force_topic else None
            recorder = running.enter_context(child_process(record_words(args)))
            nodes = [node for node in (monitor, force, recorder) if node]
            display = StatusLine(console, recording.span_s)

            def on_cycle(contacts: tuple[ContactAssessment, ...], at_ns: int) -> None:
                self._take(contacts, at_ns)
                if not args.json:
                    display.show(contacts, (at_ns - (self._first_ns or at_ns)) / 1e9, watch.speed_scaling)

            def broken() -> bool:
                return any(node.ended for node in nodes)

            with MonitorClient(tuple(self.traces), on_cycle) as watch:
                if not watch.spin(START_WITHIN_S, lambda: watch.connected or broken()):
                    raise EffmassError(f"the monitor has not come up within {START_WITHIN_S:g} s")
                require_running(nodes)
                with child_process(_replay_words(args, recording)) as replay, display:
                    nodes.remove(force) if force else None
                    watch.spin(math.inf, lambda: replay.ended or broken())
                    require_running(nodes)
                    self.replayed = json.loads(replay.output())
                    self.sent = sum(self.replayed["sent"].values())
                    self._look_back(recording, args.duration)
                    self._await_stragglers(watch)
                    if force:
                        watch.spin(FORCE_ENDS_WITHIN_S, lambda: force.ended)
                        force.finish()
                    self.recorded = json.loads(recorder.finish())

    def _look_back(self, recording: Recording, duration_s: float) -> None:
        """Find in the recording what no message tells: joint states of other devices, and the tightest one's pose."""
        from scara_effmass.bags.files import open_bag  # noqa: PLC0415

        tightest = self.summary.tightest
        with open_bag(recording.path) as bag:
            stop_ns = bag.start_ns + round(duration_s * 1e9) if duration_s < math.inf else None
            for block in bag.joint_state_blocks(recording.topic, None, stop_ns):
                if block.names and self._joints.isdisjoint(block.names):
                    self.foreign += len(block)
                elif tightest and (block.stamp_ns == tightest.contact.stamp_ns).any():
                    row = int((block.stamp_ns == tightest.contact.stamp_ns).argmax())
                    positions = dict(zip(block.names, block.position[row].tolist(), strict=True))
                    self.summary.tightest = tightest._replace(positions=positions)

    def _await_stragglers(self, watch: MonitorClient) -> None:
        watch.spin(STRAGGLERS_S, lambda: watch.cycles >= self.sent - self.foreign)
        self.cycles, self.silences = watch.cycles, watch.silences

    def _take(self, contacts: tuple[ContactAssessment, ...], at_ns: int) -> None:
        if self._first_ns is None:
            self._first_ns = at_ns
        self.summary.add(contacts, at_ns)
        for contact in contacts:
            self.traces[contact.contact_point].add(contact, at_ns)


def monitor_words(args: argparse.Namespace, settings: MonitorSettings) -> list[str]:
    """Run the monitor with the settings of the demo."""
    words = ["monitor", "--robot", str(settings.robot_path), "--model", settings.effective_mass_model.value]
    if args.params:
        words += ["--params", str(args.params)]
    return words + SIMULATED_TIME


def _force_words(recording: Recording) -> list[str]:
    """Play the force on the clock of the replay, and end when it ends."""
    words = ["daq", "--source", "bag", "--path", str(recording.path), "--topic", recording.force_topic]
    return [*words, *SIMULATED_TIME, "-p", "stop_at_end:=true"]


def record_words(args: argparse.Namespace) -> list[str]:
    """Record the run."""
    return ["record", "-o", str(args.out / BAG), "--json", *(["--force"] if args.force else []), *SIMULATED_TIME]


def _replay_words(args: argparse.Namespace, recording: Recording) -> list[str]:
    """Replay the joint states, once monitor and recorder listen."""
    words = ["replay", str(recording.path), "--topic", recording.topic, "--topics", recording.topic]
    words += ["--rate", str(args.rate), "--duration", str(args.duration)]
    return [*words, "--subscribers", "2", "--wait", str(START_WITHIN_S), "--json"]


def _settled(args: argparse.Namespace) -> tuple[MonitorSettings, RobotDynamics, str]:
    """Return settings, robot, and a line about a mass model that had to be chosen."""
    settings = settings_from(args)
    arm = arm_from(settings)
    if args.effective_mass_model or settings.effective_mass_model is not MassModel.LUMPED or not arm.lumped_reason:
        return settings, arm, ""
    instead = MassModel.ISO if arm.full_reason else MassModel.FULL
    return (
        settings_from(args, effective_mass_model=instead),
        arm,
        f"no lumped mass ({arm.lumped_reason}): {instead.value} is used",
    )


def _recording(args: argparse.Namespace) -> Recording:
    from scara_effmass.analysis.assessment import joint_state_topic  # noqa: PLC0415
    from scara_effmass.bags.files import open_bag  # noqa: PLC0415
    from scara_effmass.wire.message_types import FORCE_BLOCK  # noqa: PLC0415

    with open_bag(args.bag) as bag:
        topic = joint_state_topic(bag, args.topic)
        force_topic = next((each.name for each in bag.topics if each.type == FORCE_BLOCK), "")
        return Recording(bag.path, topic, force_topic, min(bag.duration_ns / 1e9, args.duration), _making(bag))


def _making(bag: Bag) -> str:
    """Return what the recording says of how it was made, empty where it says nothing."""
    from scara_effmass.bags.recording_info import recording_infos  # noqa: PLC0415
    from scara_effmass.impacts.run_info import json_object  # noqa: PLC0415

    _, text = next(recording_infos(bag), (0, ""))
    about = json_object(text) or {}
    told = about.get("generated") and "description" in about
    return f"generated, no real robot: {about['description']}" if told else ""


def _introduction(
    recording: Recording, arm: RobotDynamics, settings: MonitorSettings, choice: str, rate: float
) -> list[tuple[str, str]]:
    speed = f"{rate:g} times the original speed" if rate else "as fast as the monitor answers"
    lines = [
        ("recording", f"{recording.path}, {recording.topic}, {recording.span_s:.1f} s, {speed}"),
        ("its motion", recording.made or "as recorded; the recording does not say that it was generated"),
        ("live", "the monitor node, its messages and verdicts: computed now, from that motion"),
        ("not measured", "masses and forces: they come from the robot's model"),
        ("robot", f"{arm.robot.name}, {settings.robot_path}"),
        ("mass model", choice or settings.effective_mass_model.value),
    ]
    return lines + [("robot file", note) for note in arm.robot.notes]


def _recorded_forces(path: Path) -> Forces | None:
    from scara_effmass.analysis.forces import forces_of  # noqa: PLC0415
    from scara_effmass.bags.files import open_bag  # noqa: PLC0415

    with open_bag(path) as bag:
        return forces_of(bag)


def _about(forces: Forces | None) -> dict[str, Any] | None:
    if forces is None:
        return None
    return {
        "source": forces.source,
        "simulated": forces.simulated,
        "blocks": forces.blocks,
        "lost_samples": forces.lost,
        "impacts": [impact._asdict() for impact in forces.impacts],
    }


def _force_lines(forces: Forces | None) -> Iterator[tuple[str, str]]:
    if forces is None:
        return
    what = "simulated, nothing was measured" if forces.simulated else "as recorded"
    yield "force", f"{forces.blocks} blocks, {forces.samples} samples, {forces.lost} lost; {what}: {forces.source}"
    for impact in forces.impacts:
        marks = [f"rebound {impact.rebound}"] * bool(impact.rebound)
        marks += ["clipped"] * impact.clipped + ["incomplete"] * impact.incomplete
        text = f"{impact.peak_force:.1f} N, {1e3 * impact.duration:.2f} ms, {impact.impulse:.4f} N s"
        yield "  impact", f"at stamp {impact.stamp_ns / 1e9:.5f} s: {', '.join((text, *marks))}"


def _recording_lines(recorded: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    yield "recorded", f"{recorded['messages']} messages, {recorded['lost']} lost: {recorded['bag']}"
    for name, topic in recorded["topics"].items():
        yield "", f"{name}: {topic['recorded']}"


def _finish(
    args: argparse.Namespace,
    live: Live,
    recording: Recording,
    arm: RobotDynamics,
    settings: MonitorSettings,
    console: Console,
) -> None:
    """Draw, write, print."""
    from scara_effmass.analysis.figure import draw_run, save  # noqa: PLC0415
    from scara_effmass.analysis.output import completed  # noqa: PLC0415

    forces = _recorded_forces(args.out / BAG)
    tightest = live.summary.tightest
    point = tightest.contact.contact_point if tightest else next(iter(live.traces))
    model = settings.effective_mass_model.value
    figure = draw_run(
        live.traces[point].course(),
        title=f"{arm.robot.name}: {recording.path.name} through the live monitor, {model} mass",
        subtitle=f"{'generated motion, no real robot' if recording.made else 'recorded motion, modelled masses'}"
        f" · contact point {point} · below {settings.speed_threshold:g} m/s: worst direction"
        " · allowable speed includes the uncertainty margins",
        mass_model=model,
        timeout=settings.timeout,
        forces=forces,
    )
    paths = save(figure, args.out, FIGURE, overwrite=args.force)
    result = {
        "bag": str(recording.path),
        "topic": recording.topic,
        "generated": bool(recording.made),
        "robot": arm.robot.origin,
        "effective_mass_model": model,
        "sent": live.sent,
        "foreign": live.foreign,
        "received": live.cycles,
        "lost": live.lost,
        "watchdog_messages": live.silences,
        **live.summary.as_dict(),
        "late": live.replayed["late"],
        "worst_lateness_s": live.replayed["worst_lateness_s"],
        "warnings": live.replayed["warnings"],
        "force": _about(forces),
        "recording": live.recorded,
        "figures": [str(path) for path in paths],
    }
    with completed(args.out / SUMMARY, overwrite=args.force) as unfinished:
        unfinished.write_text(json.dumps(result, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    if args.json:
        console.print_json(json.dumps(result, allow_nan=False))
        return
    ignored = f", {live.foreign} of other devices" if live.foreign else ""
    console.print(f"{'cycles':<16}{live.sent} joint states sent{ignored}, {live.cycles} answered, {live.lost} lost")
    for subject, text in summary_lines(live.summary):
        console.print(f"{subject:<16}{text}")
    for subject, text in (*_force_lines(forces), *_recording_lines(live.recorded)):
        console.print(f"{subject:<16}{text}")
    if live.replayed["late"]:
        worst = f"at worst {live.replayed['worst_lateness_s']:.3f} s: this machine was too busy, not the recording"
        console.print(f"{'late':<16}{live.replayed['late']} messages were sent late, {worst}")
    for warning in live.replayed["warnings"]:
        console.print(f"{'recording':<16}{warning}")
    console.print(f"{'written':<16}{args.out / SUMMARY}")
    console.print(f"{'open':<16}{paths[0]}")
