# SPDX-License-Identifier: Apache-2.0
"""`scara-effmass coverage`."""

import argparse
import json
from functools import partial
from pathlib import Path

from scara_effmass.analysis.assessment import Time, assessed_rows, joint_state_topic
from scara_effmass.analysis.coverage import Coverage
from scara_effmass.analysis.output import check_output_files
from scara_effmass.analysis.report import figure_files, report_figure, write_report_files
from scara_effmass.bags.files import bag_bytes, find_bags, open_bag
from scara_effmass.cli.console import print_result
from scara_effmass.cli.settings import load_dynamics, monitor_settings
from scara_effmass.cli.tasks import SMALL_BYTES, Advance, open_run, sound
from scara_effmass.safety import Monitor
from scara_effmass.settings import MonitorSettings

NAME, FILE = "coverage", "coverage.json"


def run(args: argparse.Namespace) -> int:
    """Count the joint states of the recordings and of earlier files, write figure and counts, and print the shares."""
    settings = monitor_settings(args)
    check_output_files(args.output, [FILE, *figure_files([NAME])], overwrite=args.force)
    dynamics = load_dynamics(settings)
    coverage = Coverage.of_robot(dynamics.robot)
    earlier = [path for path in args.bags if path.suffix == ".json"]
    for path in earlier:
        coverage.merge(path)
    paths = [bag for folder in args.bags if folder not in earlier for bag in find_bags(folder)]
    unreadable: list[str] = []
    with open_run(args, "recordings", is_small=sum(map(bag_bytes, paths)) < SMALL_BYTES) as run_tasks:
        count = partial(_counted, settings, args.topic, Time(args.time))
        for path, counted in sound(paths, run_tasks(count, paths), unreadable):
            coverage.extend(counted, path)
    shares = coverage.shares()
    result = {"output": str(args.output), "joint_states": coverage.joint_states, "covered": shares}
    result["unreadable"] = unreadable
    text = json.dumps({**result, "coverage": coverage.model_dump(mode="json")}, allow_nan=False)
    figure = report_figure(NAME, f"Coverage of {coverage.robot}", "", coverage.figure())
    write_report_files(args.output, {FILE: f"{text}\n"}, [figure], overwrite=args.force)
    lines = [("recordings", len(coverage.recordings)), ("joint states", f"{coverage.joint_states} valid ones")]
    lines += [(name, f"{share:.1%} of its bins") for name, share in shares.items() if isinstance(share, float)]
    lines += [(name, f"fastest from {speed:g} m/s on") for name, speed in shares["fastest_bin_from_m_s"].items()]
    lines += [("not counted", error) for error in unreadable]
    print_result(result, [*lines, ("written", args.output / FILE)], as_json=args.json)
    return 1 if unreadable else 0


def _counted(settings: MonitorSettings, topic: str | None, time: Time, path: Path, advance: Advance) -> Coverage:
    """Return the coverage of the recording at `path`. Raises BagError."""
    dynamics = load_dynamics(settings)
    coverage = Coverage.of_robot(dynamics.robot)
    with open_bag(path) as bag:
        topic = joint_state_topic(bag, topic)
        coverage.begin(f"{bag.path.name}, {bag.start_ns} ns")  # also after it was moved
        share = 1.0 / next(stored.count for stored in bag.topics if stored.name == topic)
        for _, state, decision in assessed_rows(bag, topic, Monitor(dynamics, settings), time):
            advance(share)
            if state is not None:
                coverage.add(state, decision.contacts)
    return coverage
