# SPDX-License-Identifier: Apache-2.0
"""`scara-effmass impacts`."""

import argparse
from pathlib import Path

from scara_effmass.analysis.forces import force_topics, recorded_contacts
from scara_effmass.bags.files import find_bags, open_bag
from scara_effmass.cli.console import print_json, print_lines, print_table, progress_bar
from scara_effmass.cli.options import override, selected
from scara_effmass.importers.force import IMPORTERS
from scara_effmass.settings import DaqSettings, DetectionSettings, ImportSettings, checked, load_settings

OTHERS = ("monitor", "validator")
HEADINGS = ("time [s]", "peak [N]", "impulse [N s]", "duration [ms]", "held [N]", "")


def run(args: argparse.Namespace) -> int:
    """Print the contacts in each recording, and what was left out."""
    settings = override(ImportSettings(topic=args.force_topic or ""), selected(args, "import"))
    detection = load_settings(DaqSettings, args.params, "daq", OTHERS).detection
    if args.threshold is not None:
        detection = checked(DetectionSettings, {**detection.model_dump(), "threshold": args.threshold}, "options")
    with progress_bar() as progress:
        paths = [path for argument in args.bags for path in _files(argument)]
        found = [
            recorded_contacts(path, settings.model_copy(update={"topic": topic}), detection)
            for path in progress.track(paths, description="impacts")
            for topic in _topics(path, settings.topic)
        ]
    if args.json:
        count = sum(len(recording.contacts) for recording in found)
        print_json({"contacts": count, "recordings": [recording.as_dict() for recording in found]})
        return 0
    for recording in found:
        lines = [("recording", recording.path), ("force", recording.force_text), ("contacts", len(recording.contacts))]
        print_lines(lines)
        if recording.contacts:
            print_table("", HEADINGS, recording.rows())
        print_lines(recording.lines())
    return 0


def _files(path: Path) -> list[Path]:
    """Return `path` if it is a file of force, or else the recordings in it. Raises BagError."""
    return [path] if path.suffix.lower() in IMPORTERS else find_bags(path)


def _topics(path: Path, stated: str) -> list[str]:
    """Return the `stated` topic; without one, all topics of force if a recording has several. Raises BagError."""
    if stated or path.suffix.lower() in IMPORTERS:
        return [stated]
    with open_bag(path) as bag:
        topics = [topic.name for topic in force_topics(bag)]
    return topics if len(topics) > 1 else [""]
