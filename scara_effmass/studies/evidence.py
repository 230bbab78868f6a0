# SPDX-License-Identifier: Apache-2.0
"""Random impacts at the speed that the monitor allows: how often and by how much does the peak force exceed the limit?

Arm, pose, motion, acceleration, link, place on it, region, person, damping and friction of the contact, plate normal,
drives and the errors of the link masses are random. Every link is watched as a whole. The settings state what is
simulated. The same impact is simulated once for each setting of the monitor, at the speed that this setting allows for
the link. The table of the impacts is a CSV file that grows with each, so that an interrupted run can be resumed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
from matplotlib.figure import Figure
from pyarrow import compute, csv
from scipy.stats import binomtest

from scara_effmass import __version__
from scara_effmass.analysis.report import CYCLE, INK, new_figure, render, report_figure, styled, write_report_files
from scara_effmass.errors import OutputError, writing
from scara_effmass.iso15066 import Limit, limits_for
from scara_effmass.model.lumping import is_scara
from scara_effmass.settings import MonitorSettings, ServoSettings
from scara_effmass.sim.plate_sim import Peak, Surface
from scara_effmass.studies.bounds import RANDOM_ARM, RANDOM_ARMS, ROBOTS, TABLES, arm_of
from scara_effmass.values import FloatArray, at_least

Row = dict[str, str | int | float]
Simulate = Callable[[int], list[Row]]

SETTINGS: Mapping[str, Mapping[str, Any]] = TABLES["settings"]
"""Settings of the monitor that are compared, as changes of its defaults."""
BANDWIDTHS_HZ = (1.0, 2.0, 5.0, 10.0, 20.0)
DAMPING_RATIOS = (0.5, 0.7, 1.0)
FREE, COMPUTED_TORQUE, PER_JOINT = "free", "computed_torque", "per_joint"
"""Drives: free joints, or a servo, by computed torque or by a controller per joint."""

TABLE, PAGE, SUMMARY, FIGURE = "impacts.csv", "report.html", "summary.json", "evidence"
LABELS = {
    "iso": "ISO's fixed mass, M/2 + m_L",
    "free": "default, drives: free",
    "default": "default",
}
"""The settings that are compared."""
DRIVES = {
    FREE: "joints free",
    COMPUTED_TORQUE: "servo, computed torque",
    PER_JOINT: "servo, a controller per joint",
}
WORST, RANDOM = "worst", "random"
PLATES = {WORST: "worst plate normal", RANDOM: "random plate normal"}
PLACES = {WORST: "worst place of the link", RANDOM: "random place of the link"}
"""Where a link is hit: where the monitor says that it is worst, or anywhere in its hull."""
ELASTIC, LOSSY = "elastic, without friction", "damped or with friction"
"""Surfaces: what the settings state of damping and friction counts as the worst that it can do."""
GOALS = (("free", FREE), ("default", COMPUTED_TORQUE), ("default", PER_JOINT))
"""Settings, each with the drives that it assumes: the force must keep the limit."""
MAX_SHARE = 1e-3
"""Largest share of impacts above the limit that meets the goal."""
MAX_RATIO = 1.05
"""Largest peak / limit that meets it."""
MIN_MEDIAN = 0.7
"""Smallest median of peak / limit, at the worst place and plate normal, that meets the goal."""
MIN_IMPACTS = 10_000
"""Fewest impacts, of all robots and drives together, that meet a goal."""
MAX_ACCELERATION, MAX_PERSON_SPEED, MAX_DAMPING, MAX_FRICTION = 5.0, 1.6, 0.6, 1.0
"""Of the place [m/s2], of the person [m/s], damping ratio and friction coefficient of the contact."""
CONFIDENCE = 0.95
WORST_ROWS = 20
MAX_DIGITS = 10
"""Number of digits that no number of an impact reaches."""
_TEXTS = ("robot", "setting", "drives", "place", "plate")
_NUMBERS = ("ratio", "draws", "contact_damping", "contact_friction")


class Start(NamedTuple):
    """Joint velocities `qd` (n,) that a setting allows, `position` (3,) of the contact in the frame of the link [m].

    `person` (3,) is the velocity of the person, `normal` (3,) that of the plate.
    """

    qd: FloatArray
    position: FloatArray
    person: FloatArray
    normal: FloatArray


class Impact(NamedTuple):
    """One random impact, and how it starts with each setting.

    `link` is the number of the contact point, `position` (3,) a random place in its hull, which is hit if `place` is
    RANDOM. `pushing` is the servo, None for free joints. `mass_factors` (n,) are the true masses behind the joints over
    those of the robot file. `draws` counts the motions drawn until one for which every setting keeps all joints within
    their speed limits and computes a force, and the default allows a motion.
    """

    robot: str
    link: int
    position: FloatArray
    limit: Limit
    place: str
    plate: str
    servo: ServoSettings
    pushing: ServoSettings | None
    drives: str
    surface: Surface
    person_speed: float
    mass_factors: FloatArray
    q: FloatArray
    qdd: FloatArray
    starts: Mapping[str, Start]
    draws: int

    @property
    def settings(self) -> dict[str, MonitorSettings]:
        """SETTINGS for this impact."""
        values: dict[str, Any] = {
            "body_regions": (self.limit.region,),
            "servo": self.servo,
            "person_speed": self.person_speed,
            "contact_damping": self.surface.damping,
            "contact_friction": self.surface.friction,
        }
        if not is_scara(arm_of(self.robot, is_whole=True).dynamics.robot):
            values["effective_mass_model"] = "full"
        return {name: MonitorSettings.model_validate({**values, **changes}) for name, changes in SETTINGS.items()}


def draw_impact(seed: int, index: int) -> Impact:
    """Return random impact number `index` of the series `seed`.

    Robot, plate normal (the worst one of the pose, or a random one), drives (free joints, or a servo) and place (the
    worst one of the link, or a random one) take turns; every fifth robot is a random arm. A motion is
    drawn again if a setting allows a joint to exceed its speed limit, now or by its acceleration during the contact, or
    if the default allows none.
    """
    rng = np.random.default_rng((seed, index))
    turn, robot = divmod(index, len(ROBOTS) + 1)
    name = f"{RANDOM_ARM}{rng.integers(RANDOM_ARMS)}" if robot == len(ROBOTS) else list(ROBOTS)[robot]
    arm = arm_of(name, is_whole=True)
    limits = limits_for(MonitorSettings())
    limit = limits[int(rng.integers(len(limits)))]
    bandwidth, damping = float(rng.choice(BANDWIDTHS_HZ)), float(rng.choice(DAMPING_RATIOS))
    servo = ServoSettings(bandwidth=bandwidth, damping=damping, computed_torque=bool(rng.integers(2)))
    uncertainty = MonitorSettings().mass_uncertainty
    factors = rng.uniform(1.0 - uncertainty, 1.0 + uncertainty, arm.sim.n)
    drives = FREE if turn // 2 % 2 == 0 else COMPUTED_TORQUE if servo.computed_torque else PER_JOINT
    arm.sim.scale_masses(factors)
    draws = 0
    while True:
        draws += 1
        link = int(rng.choice(arm.links()))
        position = arm.random_place(rng, link)
        arm.sim.move_contact(link, position)
        q, creep = arm.draw_motion(rng, link, straight=bool(rng.integers(2)))
        impact = Impact(
            robot=name,
            link=link,
            position=position,
            limit=limit,
            place=WORST if turn // 4 % 2 == 0 else RANDOM,
            plate=WORST if turn % 2 == 0 else RANDOM,
            servo=servo,
            pushing=None if drives == FREE else servo,
            drives=drives,
            surface=Surface(_sometimes(rng, MAX_DAMPING), _sometimes(rng, MAX_FRICTION)),
            person_speed=_sometimes(rng, 1.0) ** 2 * MAX_PERSON_SPEED,  # slow ones leave a speed more often
            mass_factors=factors,
            q=q,
            qdd=arm.accelerations(rng, q, link, _sometimes(rng, MAX_ACCELERATION)),
            starts={},
            draws=draws,
        )
        if starts := _starts(impact, creep, rng):
            return impact._replace(starts=starts)


def _sometimes(rng: np.random.Generator, largest: float) -> float:
    """Return 0 in one half of the cases, else a random number up to `largest`."""
    return float(rng.uniform(0.0, largest)) if rng.integers(2) else 0.0


def _starts(impact: Impact, creep: FloatArray, rng: np.random.Generator) -> dict[str, Start]:
    """Return the start of the impact with each setting, for the motion `creep` (n,); empty to draw again."""
    arm, q, limit, link = arm_of(impact.robot, is_whole=True), impact.q, impact.limit, impact.link
    series, starts = int(rng.integers(2**32)), {}
    for name, settings in impact.settings.items():
        qd = arm.allowed(q, creep, settings, link, impact.qdd)
        if qd is None or (name == "default" and not qd.any()):
            return {}
        moving, same = qd if qd.any() else creep, np.random.default_rng(series)  # the same directions for each setting
        direction = same.normal(size=3)
        person = impact.person_speed * direction / np.linalg.norm(direction)
        position = impact.position
        if impact.place == WORST:
            contacts = arm.monitor(settings).assess_configurations(q[None], moving[None], impact.qdd).contacts
            position = np.array(contacts[0, link]["position_in_link"])
        arm.sim.move_contact(link, position)
        if impact.plate == WORST:
            person = arm.sim.worst_person(q, moving, limit, impact.person_speed, link)
        normal = arm.plate_normal(impact.plate, q, moving, limit, same, impact.pushing, link, person)
        starts[name] = Start(qd, position, person, normal)
    return starts


def simulate(seed: int, index: int) -> list[Row]:
    """Return a row for each setting of random impact number `index`; names hold the units, vectors are text."""
    impact = draw_impact(seed, index)
    arm, servo, limit = arm_of(impact.robot, is_whole=True), impact.servo, impact.limit
    rows: list[Row] = []
    for setting, (qd, position, person, normal) in impact.starts.items():
        arm.sim.move_contact(impact.link, position)
        jacobian, _ = arm.sim.kinematics(impact.q, impact.link)
        peak = Peak(0.0, 0.0, 0.0)
        if qd.any():
            options: dict[str, Any] = {"qdd": impact.qdd, "surface": impact.surface, "person": person}
            peak = arm.sim.touch(impact.q, qd, normal, limit, impact.pushing, impact.link, **options)
        rows.append(
            {
                "index": index,
                "robot": RANDOM_ARM.strip() if impact.robot.startswith(RANDOM_ARM) else impact.robot,
                "arm": impact.robot,
                "link": arm.dynamics.contact_points[impact.link],
                "region": impact.limit.region,
                "place": impact.place,
                "plate": impact.plate,
                "drives": impact.drives,
                "bandwidth_hz": servo.bandwidth,
                "damping": servo.damping,
                "draws": impact.draws,
                "setting": setting,
                "speed_m_s": float(np.linalg.norm(jacobian @ qd)),
                "limit_n": impact.limit.permissible_force_n,
                "peak_n": peak.force,
                "ratio": peak.force / impact.limit.permissible_force_n,
                "time_to_peak_s": peak.time,
                "turn_to_peak": peak.turn,
                "person_speed_m_s": impact.person_speed,
                "contact_damping": impact.surface.damping,
                "contact_friction": impact.surface.friction,
                "position_in_link": _text(position),
                "normal": _text(normal),
                "person": _text(person),
                "mass_factors": _text(impact.mass_factors),
                "q": _text(impact.q),
                "qd": _text(qd),
                "qdd": _text(impact.qdd),
            }
        )
    return rows


def _text(vector: FloatArray) -> str:
    return " ".join(map(repr, vector.tolist()))


def extend_table(
    path: Path,
    seed: int,
    impacts: int,
    run: Callable[[Simulate, Sequence[int]], Iterable[list[Row]]] = map,
) -> None:
    """Append random impacts of the series `seed` to the CSV file `path` until it has `impacts`.

    The last impact of an existing table is simulated again and must give the same rows, so that the result is that of a
    run without interruption. `run` simulates impacts by their numbers and yields their rows in that order. Raises
    OutputError if the table has another seed or version, or cannot be written.
    """
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("a+", encoding="utf-8", errors="replace", newline="\n") as file:
            file.seek(0)
            text = file.read()
            lines = [line for line in text.splitlines(keepends=True) if line.endswith("\n")]
            number = lines[-1].partition(",")[0] if lines else ""
            last = int(number) if number.isdecimal() and len(number) < MAX_DIGITS else 0
            kept = [line for line in lines if not line.startswith(f"{last},")]
            rows = simulate(seed, last)
            header, again = ",".join(rows[0]) + "\n", _lines(rows)
            is_same = lines[:1] == [header] and again.startswith("".join(lines[len(kept) :]))
            if not (is_same or header.startswith(text)):
                raise OutputError(f"{path}: must be of this seed and version; choose another folder, or use --force")
            file.truncate(sum(map(len, kept)))
            file.write(again if kept else header + again)
            file.flush()
            for rows in run(partial(simulate, seed), range(last + 1, impacts)):
                file.write(_lines(rows))
                file.flush()


def _lines(rows: Iterable[Row]) -> str:
    return "".join(",".join(map(str, row.values())) + "\n" for row in rows)


class Group(NamedTuple):
    """Peak force / limit in one group of impacts; `interval` is the confidence interval of the share above 1."""

    setting: str
    drives: str
    place: str
    plate: str
    robot: str
    surface: str
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
        """Read the table that `extend_table` wrote. Raises OutputError if it is damaged."""
        types = {name: pa.string() for name in _TEXTS} | {name: pa.float64() for name in _NUMBERS}
        try:
            self.table = csv.read_csv(
                path, convert_options=csv.ConvertOptions(column_types={**types, "index": pa.int64()})
            )
            is_sound = all(bool(np.isfinite(self.table[name]).all()) for name in _NUMBERS)
        except (pa.ArrowException, OSError, KeyError, TypeError):
            is_sound = False
        if not (is_sound and self.table.num_rows and {"index", *_TEXTS} <= {*self.table.column_names}):
            raise OutputError(f"{path}: is damaged: must be a table of impacts; choose another folder, or use --force")
        is_elastic = np.add(*(np.asarray(self.table[name]) for name in ("contact_damping", "contact_friction"))) == 0.0
        self.table = self.table.append_column("surface", [np.where(is_elastic, ELASTIC, LOSSY)])
        self.impacts = int(compute.count_distinct(self.table["index"]).as_py())
        self.robots = list(dict.fromkeys(self.table["robot"].to_pylist()))
        self.draws = int(compute.sum(self.table["draws"]).as_py()) / self.table.num_rows

    def ratios(self, **values: str) -> FloatArray:
        """Return peak / limit of the rows whose columns have `values`."""
        return np.asarray(self._rows(**values)["ratio"])

    def group(self, setting: str, drives: str, **values: str) -> Group | None:
        """Return the statistics of one group, by place, plate, robot or surface; None without impacts."""
        chosen = {"setting": setting, "drives": drives, "place": "", "plate": "", "robot": "", "surface": "", **values}
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

    def groups(self, **cases: Iterable[str]) -> list[Group]:
        """Return the groups of all combinations of `cases` that have impacts, by drives first and setting last."""
        combinations = product(DRIVES, *cases.values(), LABELS)
        groups = (
            self.group(setting, drives, **dict(zip(cases, case, strict=True)))
            for drives, *case, setting in combinations
        )
        return [group for group in groups if group]

    def tables(self) -> dict[str, list[Group]]:
        """Return the groups by place and plate, by robot, and by surface and robot where both are worst."""
        worst = {"place": (WORST,), "plate": (WORST,)}
        return {
            "place": self.groups(place=PLACES, plate=PLATES),
            "robot": self.groups(robot=self.robots),
            "surface": self.groups(**worst, surface=(ELASTIC, LOSSY)),
            "worst": self.groups(**worst, robot=self.robots),
        }

    def largest(self) -> list[dict[str, Any]]:
        """Return the rows with the largest peak / limit, of settings on the drives that they assume."""
        parts = [self._rows(setting=setting, drives=drives) for setting, drives in GOALS]
        rows: list[dict[str, Any]] = pa.concat_tables(parts).sort_by([("ratio", "descending")])[:WORST_ROWS].to_pylist()
        return rows

    @property
    def sentence(self) -> str:
        """The result of the default over all drives."""
        if (group := self.group("default", "")) is None:
            return "no impact with the default"
        kept = f"kept in {group.impacts - group.above} of {group.impacts} simulated impacts"
        worst = f"worst force {at_least(group.worst, 3)} of it"
        return f"With the default the limit was {kept} ({worst}), with everything stated that robot and person do"

    def goals(self) -> list[tuple[str, str, bool]]:
        """Return for each goal its subject, the result, and whether it is met; too few impacts do not meet it."""
        goals = []
        enough = self.impacts >= MIN_IMPACTS
        few = "" if enough else f"too few impacts: {self.impacts} of at least {MIN_IMPACTS}; "
        for setting, drives in GOALS:
            subject = f"{LABELS[setting]}; {DRIVES[drives]}"
            if group := self.group(setting, drives):
                text = f"{group.share:.2%} above the limit ({group.above} of {group.impacts}, worst {group.worst:.3f})"
                text += f"; must be at most {MAX_SHARE:.1%}, the worst {MAX_RATIO:g}"
                met = group.share <= MAX_SHARE and group.worst <= MAX_RATIO
                goals.append((subject, few + text, met and enough))
            if group := self.group(setting, drives, place=WORST, plate=WORST):
                text = f"median of peak / limit {group.median:.3f} at the worst place and normal"
                text += f"; must be at least {MIN_MEDIAN:g}"
                goals.append((subject, few + text, group.median >= MIN_MEDIAN and enough))
        return goals

    def as_dict(self) -> dict[str, Any]:
        """Return the statistics for JSON."""
        cases = [group for table in self.tables().values() for group in table]
        return {
            "simulated": True,
            "impacts": self.impacts,
            "robots": self.robots,
            "result": self.sentence,
            "groups": [group._asdict() | {"share": group.share} for group in cases],
            "goals": [{"subject": subject, "result": text, "met": met} for subject, text, met in self.goals()],
            "scara_effmass": __version__,
        }

    def _rows(self, **values: str) -> pa.Table:
        rows = self.table
        for column, value in values.items():
            rows = rows.filter(compute.equal(rows[column], value))
        return rows


@styled
def draw_evidence(evidence: Evidence) -> Figure:
    """Return the figure: share of the impacts above a multiple of the limit, for each setting."""
    title = f"Peak force over limit at the allowed speed: {evidence.impacts} simulated impacts"
    figure = new_figure(11.0, 10.0, title)
    panels = figure.subplots(len(DRIVES), len(PLACES), sharex=True, sharey=True)
    for axes, (drives, place) in zip(panels.flat, product(DRIVES, PLACES), strict=True):
        for colour, (setting, label) in zip(CYCLE, LABELS.items(), strict=False):
            ratios = np.sort(evidence.ratios(setting=setting, drives=drives, place=place, plate=WORST))
            if len(ratios):
                share = 1.0 - np.arange(len(ratios)) / len(ratios)
                axes.step(ratios, share, where="pre", color=colour, label=label, linewidth=1.8)
        if not axes.get_lines():
            axes.text(
                0.5, 0.5, "no impact at the worst normal", transform=axes.transAxes, ha="center", backgroundcolor="w"
            )
        axes.axvline(1.0, color=INK, linewidth=1.0)
        axes.axhline(0.5, color=INK, linewidth=0.6, linestyle=":")
        axes.set(title=f"{DRIVES[drives]}, {PLACES[place]}", yscale="log", xlim=(0.0, 2.5))
        axes.grid(alpha=0.3)
    for axes in panels[:, 0]:
        axes.set_ylabel("share of impacts above")
    for axes in panels[-1]:
        axes.set_xlabel("peak force / limit")
    handles = {
        label: line for axes in panels.flat for line, label in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=2)
    return figure


def write_evidence(folder: Path, seed: int) -> Evidence:
    """Write page, figure and summary of the table in `folder`, over earlier ones; return its statistics.

    Raises OutputError.
    """
    evidence = Evidence(folder / TABLE)
    caption = (
        "Share of the impacts at the worst normal whose peak is above a multiple of the limit; dotted: the median."
    )
    figure = report_figure(FIGURE, "Peak force over limit.", caption, draw_evidence(evidence))
    texts: dict[str, Any] = {"labels": LABELS, "drives": DRIVES, "places": PLACES, "plates": PLATES}
    page = render("evidence.html", evidence=evidence, seed=seed, figure=figure, **texts)
    summary = {"seed": seed} | evidence.as_dict()
    write_report_files(folder, {PAGE: page, SUMMARY: summary}, [figure], overwrite=True)
    return evidence
