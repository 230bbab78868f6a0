# SPDX-License-Identifier: Apache-2.0
"""Print line and branch coverage of each room, from the data file that `pytest --cov` wrote.

Usage: coverage_table.py [ROOM ...]
"""

from __future__ import annotations

import json
import sys
import tempfile
from collections import Counter, defaultdict
from pathlib import Path

import coverage

measured = coverage.Coverage()
measured.load()
with tempfile.TemporaryDirectory() as folder:
    report = Path(folder) / "coverage.json"
    measured.json_report(outfile=str(report))
    files = json.loads(report.read_text(encoding="utf-8"))["files"]

rooms: defaultdict[str, Counter[str]] = defaultdict(Counter)
for path, result in files.items():
    rooms[Path(path).parts[1].removesuffix(".py")].update(
        {key: value for key, value in result["summary"].items() if isinstance(value, int)}
    )

print(f"{'room':<12} {'lines':>6} {'covered':>8} {'branches':>9} {'covered':>8}")
for room, count in sorted(rooms.items()):
    if sys.argv[1:] and room not in sys.argv[1:]:
        continue
    lines, branches = count["num_statements"], count["num_branches"]
    line_share = count["covered_lines"] / lines if lines else 1.0
    branch_share = count["covered_branches"] / branches if branches else 1.0
    print(f"{room:<12} {lines:>6} {line_share:>8.1%} {branches:>9} {branch_share:>8.1%}")
