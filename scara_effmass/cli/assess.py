"""`scara-effmass assess`."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.progress import Progress

from scara_effmass.cli.options import (
    add_force,
    add_json,
    add_limits,
    add_params,
    add_robot,
    add_topic,
    arm_from,
    printer,
    settings_from,
)
from scara_effmass.cli.report import summary_lines
from scara_effmass.errors import BagError, RobotError

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable

    from scara_effmass.analysis.closed_form_check import ClosedFormCheck
    from scara_effmass.analysis.summary import Summary
    from scara_effmass.analysis.tables import Sink
    from scara_effmass.bags.bag import Bag
    from scara_effmass.model.dynamics import RobotDynamics
    from scara_effmass.settings import MonitorSettings

EXAMPLES = """\
FILE ends in .parquet, .csv or .mcap. Every bag starts with a fresh monitor; the time a joint state was
recorded at stands for the node's clock.

examples:
  scara-effmass assess bags/tour -o tour.parquet
  scara-effmass assess monday.mcap tuesday.mcap -o week.csv --robot my_robot.urdf --model full
  scara-effmass assess bags/tour -o tour.mcap --region hand_fingers --json
"""


class Run:
    """All recordings of one call: what is counted beside the summary."""

    def __init__(self, arm: RobotDynamics, settings: MonitorSettings) -> None:
        """Prepare; a robot that is no SCARA has no closed forms to check against."""
        from scara_effmass.analysis.closed_form_check import ClosedFormCheck  # noqa: PLC0415 - not needed for --help
        from scara_effmass.analysis.summary import Summary  # noqa: PLC0415

        self.arm = arm
        self.settings = settings
        self.summary: Summary = Summary(round(settings.timeout * 1e9))
        self.check: ClosedFormCheck | None = None
        self.check_reason = ""
        try:
            self.check = ClosedFormCheck(arm, settings.mass_cap)
        except RobotError as error:
            self.check_reason = str(error)
        self.joint_states = self.foreign = self.refused = 0
        self.losses: list[str] = []

    def take(self, bag: Bag, topic: str, sink: Sink, advance: Callable[[], object]) -> None:
        """Assess every joint state on `topic`. Raises EffmassError."""
        from scara_effmass.analysis.assessment import cycles  # noqa: PLC0415
        from scara_effmass.safety import Monitor  # noqa: PLC0415

        monitor = Monitor(self.arm, self.settings)
        self.summary.new_recording()
        name = str(bag.path)
        count = 0
        for at_ns, state, decision in cycles(bag, topic, monitor):
            count += 1
            advance()
            if decision is None:
                continue
            sink.add(name, at_ns, decision.contacts)
            self.summary.add(decision.contacts, at_ns, state, name)
            if self.check is not None and state is not None:
                self.check.add(state, decision.contacts)
        if monitor.ignored == count > 0:
            names = ", ".join(self.arm.robot.joint_names)
            raise BagError(f"{bag.path}: {topic}: none of its joint states names a joint of the robot ({names})")
        self.joint_states += count
        self.foreign += monitor.ignored
        self.refused += monitor.rejected
        self.losses += bag.losses

    def as_dict(self) -> dict[str, Any]:
        """Return the result as JSON takes it."""
        checked, worst = (0, None) if self.check is None else self.check.result()
        return {
            "joint_states": self.joint_states,
            "foreign": self.foreign,
            "refused": self.refused,
            **self.summary.as_dict(),
            "losses": self.losses,
            "closed_form_check": {"rows": checked, "worst_relative_difference": worst, "reason": self.check_reason},
        }

    def lines(self) -> list[tuple[str, str]]:
        """Return the result as a person reads it."""
        result = self.as_dict()
        counted = f"{self.joint_states}"
        if self.foreign:
            counted += f", of which {self.foreign} name none of the robot's joints and were ignored"
        lines = [("joint states", counted), *summary_lines(self.summary)]
        if self.refused:
            lines.append(("refused", f"{self.refused} could not be used (UNKNOWN)"))
        check = result["closed_form_check"]
        if check["rows"]:
            found = f"largest relative difference {check['worst_relative_difference']:.1e}"
            lines.append(("check", f"lumped masses of {check['rows']} rows against Eqs. 28 and 30: {found}"))
        return lines + [("not read", loss) for loss in self.losses]


def add_to(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.epilog = EXAMPLES
    parser.add_argument("bags", nargs="+", type=Path, metavar="BAG", help="recording, or folder of recordings")
    parser.add_argument("-o", "--output", required=True, type=Path, metavar="FILE", help=".parquet, .csv or .mcap")
    add_topic(parser)
    add_robot(parser)
    add_limits(parser)
    add_params(parser)
    add_force(parser)
    add_json(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Assess, write, and print what it comes down to."""
    from scara_effmass.analysis.assessment import joint_state_topic  # noqa: PLC0415
    from scara_effmass.analysis.tables import Provenance, sink  # noqa: PLC0415
    from scara_effmass.bags.files import find_bags, open_bag  # noqa: PLC0415
    from scara_effmass.safety import Monitor  # noqa: PLC0415

    settings = settings_from(args)
    arm = arm_from(settings)
    Monitor(arm, settings)  # refuses limits that do not exist before anything is written
    paths = [path for given in args.bags for path in find_bags(given)]
    work = Run(arm, settings)
    provenance = Provenance(settings, arm.robot.origin, paths)
    progress = Progress(console=Console(stderr=True), disable=not sys.stderr.isatty(), transient=True)
    with sink(args.output, provenance, arm.robot.base_frame, overwrite=args.force) as output, progress:
        for path in paths:
            with open_bag(path) as bag:
                topic = joint_state_topic(bag, args.topic)
                count = next(each.count for each in bag.topics if each.name == topic)
                task = progress.add_task(path.name, total=count)
                work.take(bag, topic, output, lambda task=task: progress.advance(task))  # type: ignore[misc]
    if args.json:
        printer().print_json(json.dumps({"output": str(args.output), **work.as_dict()}, allow_nan=False))
    else:
        console = printer()
        for subject, text in work.lines():
            console.print(f"{subject:<16}{text}")
        console.print(f"{'written':<16}{args.output}")
    return 0
