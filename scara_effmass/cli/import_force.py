# SPDX-License-Identifier: Apache-2.0
"""`scara-effmass import`."""

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path

from scara_effmass.cli.console import print_result
from scara_effmass.errors import SettingsError
from scara_effmass.importers.force import ImportedTopic, write_force_bag
from scara_effmass.importers.joint_states import write_joint_state_bag
from scara_effmass.settings import ImportSettings, checked
from scara_effmass.settings.loading import flat_fields


def run(args: argparse.Namespace) -> int:
    """Write the bag and print its contents."""
    if args.joints:
        return _import_joint_states(args)
    names = flat_fields(ImportSettings)
    stated = {name: value for name, value in vars(args).items() if name in names and value is not None}
    settings = checked(ImportSettings, stated, "options")
    topics = write_force_bag(args.files, args.output, settings, overwrite=args.force)
    result = {"output": str(args.output), "topics": [asdict(topic) for topic in topics]}
    print_result(result, _lines(topics, args.output), as_json=args.json)
    return 0


def _import_joint_states(args: argparse.Namespace) -> int:
    if len(args.files) > 1:
        raise SettingsError(f"--joints = {args.joints}: must belong to one file, not to {len(args.files)}")
    (path,) = args.files
    imported = write_joint_state_bag(path, args.joints, args.output, overwrite=args.force)
    span = f"{imported.first_stamp_s:.3f} to {imported.last_stamp_s:.3f} s"
    velocity = "with velocities" if imported.has_velocity else "without velocities (assess --velocity from-positions)"
    lines = [("/joint_states", f"{path.name}: {imported.joint_states} joint states, {span}, {velocity}")]
    if imported.shift_s:
        lines.append(("time", f"{imported.shift_s:.3f} s later than in the file, which begins at 0 or before"))
    result = {"output": str(args.output), **imported._asdict()}
    print_result(result, [*lines, ("written", args.output)], as_json=args.json)
    return 0


def _lines(topics: Sequence[ImportedTopic], output: Path) -> Iterator[tuple[str, str]]:
    for topic in topics:
        counts = f"{topic.samples} samples at {topic.sample_rate_hz:.9g} Hz, {topic.lost_samples} lost"
        yield topic.topic, f"{topic.source}: {counts}, {topic.saturated_samples} saturated"
        for loss in topic.losses:
            yield "not read", loss
    yield "written", str(output)
