# SPDX-License-Identifier: Apache-2.0
"""Report of random impacts at the allowed speed: how often and by how much the peak force exceeds the limit."""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
import pyarrow as pa
from matplotlib.figure import Figure
from pyarrow import compute, csv
from scipy.stats import binomtest

from scara_effmass import __version__
from scara_effmass.analysis.report import CYCLE, INK, STYLE, new_figure, render, report_figure, write_report_files
from scara_effmass.values import FloatArray

TABLE, PAGE, SUMMARY, FIGURE = "impacts.csv", "report.html", "summary.json", "evidence"
LABELS = {
    "paper": "the paper: lumped mass, contact normal along the velocity",
    "iso": "ISO's fixed mass, M/2 + m_L",
    "default": "default",
    "servo": "default, drives: servo",
}
"""The settings that are compared."""
DRIVES = {
    "free": "joints free",
    "computed_torque": "servo, computed torque",
    "per_joint": "servo, a controller per joint",
}
PLATES = {"worst": "worst plate normal", "random": "random plate normal"}
GOALS = (("default", "free"), ("servo", "computed_torque"), ("servo", "per_joint"))
"""Settings, each with the drives that it assumes: the force must keep the limit."""
MAX_SHARE = 1e-3
"""Largest share of impacts above the limit that meets the goal."""
MIN_MEDIAN = 0.75
"""Smallest median of peak / limit, at the worst plate normal, that meets the goal."""
CONFIDENCE = 0.95
WORST_ROWS = 20


class Group(NamedTuple):
    """Peak force / limit in one group of impacts; `interval` is the confidence interval of the share above 1."""

    setting: str
    drives: str
    plate: str
    robot: str
    impacts: int
    above: int
    interval: tuple[float, float]
    worst: float
    median: float

    @property
    def share(self) -> float:
        """Share of impacts above the limit."""
        return self.above / self.impacts


class Evidence:
    """Statistics of a table of random impacts, a row per impact and setting."""

    def __init__(self, path: Path) -> None:
        """Read the table that `sim.impact_table.extend_table` wrote."""
        self.table = csv.read_csv(path)
        self.impacts = int(compute.count_distinct(self.table["index"]).as_py())
        self.robots = list(dict.fromkeys(self.table["robot"].to_pylist()))
        self.draws = int(compute.sum(self.table["draws"]).as_py()) / self.table.num_rows

    def ratios(self, **values: str) -> FloatArray:
        """Return peak / limit of the rows whose columns have `values`."""
        return np.asarray(self._rows(**values)["ratio"])

    def group(self, setting: str, drives: str, plate: str = "", robot: str = "") -> Group | None:
        """Return the statistics of one group, None without impacts; an empty plate or robot stands for all of them."""
        chosen = {"setting": setting, "drives": drives, "plate": plate, "robot": robot}
        ratios = self.ratios(**{column: value for column, value in chosen.items() if value})
        if not len(ratios):
            return None
        above = int(np.sum(ratios > 1.0))
        ends = binomtest(above, len(ratios)).proportion_ci(CONFIDENCE)  # Clopper and Pearson
        return Group(
            **chosen,
            impacts=len(ratios),
            above=above,
            interval=(float(ends.low), float(ends.high)),
            worst=float(ratios.max()),
            median=float(np.median(ratios)),
        )

    def groups(self, plates: tuple[str, ...] = (*PLATES,), robots: tuple[str, ...] = ("",)) -> list[Group]:
        """Return the groups that have impacts, in the order of drives, plate, robot and setting."""
        cases = product(DRIVES, plates, robots, LABELS)
        groups = (self.group(setting, drives, plate, robot) for drives, plate, robot, setting in cases)
        return [group for group in groups if group]

    def largest(self) -> list[dict[str, Any]]:
        """Return the rows with the largest peak / limit, of settings on the drives that they assume."""
        parts = [self._rows(setting=setting, drives=drives) for setting, drives in GOALS]
        rows: list[dict[str, Any]] = pa.concat_tables(parts).sort_by([("ratio", "descending")])[:WORST_ROWS].to_pylist()
        return rows

    def goals(self) -> list[tuple[str, str, bool]]:
        """Return for each goal its subject, the result, and whether it is met."""
        goals = []
        for setting, drives in GOALS:
            if group := self.group(setting, drives):
                text = f"{group.share:.2%} above the limit ({group.above} of {group.impacts}, worst {group.worst:.3f})"
                met = group.share <= MAX_SHARE
                goals.append((f"{LABELS[setting]}; {DRIVES[drives]}", f"{text}; must be at most {MAX_SHARE:.1%}", met))
            if group := self.group(setting, drives, "worst"):
                text = f"median of peak / limit {group.median:.3f} at the worst normal; must be at least {MIN_MEDIAN:g}"
                goals.append((f"{LABELS[setting]}; {DRIVES[drives]}", text, group.median >= MIN_MEDIAN))
        return goals

    def as_dict(self) -> dict[str, Any]:
        """Return the statistics for JSON."""
        cases = self.groups() + self.groups(("",), tuple(self.robots))
        return {
            "simulated": True,
            "impacts": self.impacts,
            "robots": self.robots,
            "groups": [group._asdict() | {"share": group.share} for group in cases],
            "goals": [{"subject": subject, "result": text, "met": met} for subject, text, met in self.goals()],
            "scara_effmass": __version__,
        }

    def _rows(self, **values: str) -> pa.Table:
        rows = self.table
        for column, value in values.items():
            rows = rows.filter(compute.equal(rows[column], value))
        return rows


def draw_evidence(evidence: Evidence) -> Figure:
    """Return the figure: share of the impacts above a multiple of the limit, for each setting."""
    with mpl.rc_context(STYLE):
        title = f"Peak force over limit at the allowed speed: {evidence.impacts} simulated impacts"
        figure = new_figure(11.0, 10.0, title)
        panels = figure.subplots(len(DRIVES), len(PLATES), sharex=True, sharey=True)
        for axes, (drives, plate) in zip(panels.flat, product(DRIVES, PLATES), strict=True):
            for colour, (setting, label) in zip(CYCLE, LABELS.items(), strict=True):
                ratios = np.sort(evidence.ratios(setting=setting, drives=drives, plate=plate))
                if len(ratios):
                    share = 1.0 - np.arange(len(ratios)) / len(ratios)
                    axes.step(ratios, share, where="pre", color=colour, label=label, linewidth=1.8)
            axes.axvline(1.0, color=INK, linewidth=1.0)
            axes.axhline(0.5, color=INK, linewidth=0.6, linestyle=":")
            axes.set(title=f"{DRIVES[drives]}, {PLATES[plate]}", yscale="log", xlim=(0.0, 2.5))
            axes.grid(alpha=0.3)
        for axes in panels[:, 0]:
            axes.set_ylabel("share of impacts above")
        for axes in panels[-1]:
            axes.set_xlabel("peak force / limit")
        handles, labels = panels[0, 0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=2)
    return figure


def write_evidence(folder: Path, seed: int, *, overwrite: bool) -> Evidence:
    """Write page, figure and summary of the table in `folder`; return its statistics. Raises OutputError."""
    evidence = Evidence(folder / TABLE)
    caption = "Share of the impacts whose peak force is above a multiple of the limit; dotted: the median."
    figure = report_figure(FIGURE, "Peak force over limit.", caption, draw_evidence(evidence))
    page = render(
        "evidence.html",
        evidence=evidence,
        seed=seed,
        figure=figure,
        labels=LABELS,
        drives=DRIVES,
        plates=PLATES,
        version=__version__,
    )
    summary = {"seed": seed} | evidence.as_dict()
    write_report_files(folder, {PAGE: page, SUMMARY: summary}, [figure], overwrite=overwrite)
    return evidence
