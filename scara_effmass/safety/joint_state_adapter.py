# SPDX-License-Identifier: Apache-2.0
"""From joint states as published or recorded to arrays in the joint order of the robot."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Sequence
from difflib import SequenceMatcher
from fnmatch import fnmatchcase
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scara_effmass.codes import Reason
from scara_effmass.errors import SettingsError
from scara_effmass.kernel.velocity import VelocityWindow
from scara_effmass.model.description import HeldJoint
from scara_effmass.settings import MonitorSettings, VelocitySource
from scara_effmass.settings.loading import nearest
from scara_effmass.values import FloatArray, JointState

MIN_SIMILARITY = 0.3
"""Smallest ratio of difflib at which two names count as similar."""
MAX_NAMES = 64
"""Number of names up to which similar ones are searched."""
MAX_LAYOUTS = 64
"""Number of different names in joint states that are remembered."""
NONE = Reason.NONE


class Layout(NamedTuple):
    """What the names of joint states mean: places of the robot's joints in them, or the reason why they are refused.

    `is_foreign`: none of them is a joint of the robot, so the joint states are of another device. `is_ordered`: they
    are the joints of the robot, in its order. The reason is a code with a joint, a text and a number. `others` are the
    places of joints that are not in the model and not stated as harmless.
    """

    names: tuple[str, ...]
    order: NDArray[np.intp]
    is_ordered: bool
    is_foreign: bool
    reason: Reason = NONE
    joint: int = 0
    detail: str = ""
    value: float = 0.0
    others: tuple[int, ...] = ()


class JointStateAdapter:
    """Renames joints, puts them in order, and filters the velocity or computes it from positions."""

    def __init__(
        self,
        joints: tuple[str, ...],
        settings: MonitorSettings,
        periods: FloatArray | None = None,
        held: Collection[HeldJoint] = (),
    ) -> None:
        """Expect the `joints` of a robot, whose positions have `periods` (n,), 0 for none; `held` are fixed ones.

        Raises SettingsError for a `joint_map` or `joint_names` that miss them.
        """
        self._joints, self._periods = joints, np.zeros(len(joints)) if periods is None else periods
        self._held = {joint.name for joint in held}
        self._harmless = {joint.name for joint in held if joint.is_harmless}
        self._ignored = settings.ignored_joints
        self.matched = self._ignored_by(self._held)
        """Patterns of `ignored_joints` that have fitted a joint of the joint states, or that the model holds."""
        self.expected = [joint.name for joint in held if joint.is_expected and not self._ignored_by([joint.name])]
        """Joints that the model holds, without which joint states are incomplete."""
        self._series = {_numbered(joint) for joint in joints if _numbered(joint) != joint}
        self._map, self._joint_names = settings.joint_renames, settings.joint_names
        self._layouts: dict[tuple[str, ...], Layout] = {}
        self._reported: tuple[str, ...] | None = None
        self._layout: Layout
        self._filtered_names: tuple[str, ...] = ()
        for entry, (_, name) in zip(settings.joint_map, self._map, strict=True):
            if "\\" not in name and name not in self._joints:
                raise SettingsError(f"joint_map = {entry!r}: {name}: {nearest(name, joints)}")
        for name in settings.ignored_joints:
            if name in joints:
                raise SettingsError(f"ignored_joints = {name!r}: must not be a joint that the model moves")
        if self._joint_names:
            layout = self.layout(())
            missing = ", ".join(joint for joint in joints if joint not in layout.names)
            is_ambiguous = layout.reason is Reason.SEVERAL_NAMES
            if is_ambiguous or missing:
                problem = f"joint_map gives joint {layout.detail}" if is_ambiguous else f"must hold {missing}"
                raise SettingsError(f"joint_names = {', '.join(self._joint_names)}: {problem}")
        self.apply(settings)

    def apply(self, settings: MonitorSettings) -> None:
        """Apply a changed velocity source, window or timeout."""
        self._from_positions = settings.velocity_source is VelocitySource.FROM_POSITIONS
        self._window: VelocityWindow | None = None
        if settings.filters_velocity:
            window = settings.velocity_window
            self._window = VelocityWindow(self._periods, window, settings.timeout, self._from_positions)

    def forget(self) -> None:
        """Discard the samples behind the velocity."""
        if self._window is not None:
            self._window.reset()

    def layout(self, reported: tuple[str, ...]) -> Layout:
        """Return the layout of joint states with the `reported` names."""
        if reported is not self._reported:
            if reported not in self._layouts:
                if len(self._layouts) == MAX_LAYOUTS:
                    self._layouts.clear()
                self._layouts[reported] = self._layout_of(reported or self._joint_names)
            self._reported, self._layout = reported, self._layouts[reported]
        return self._layout

    def positions(self, state: JointState) -> FloatArray | str:
        """Return the positions (n,) of the robot's joints in `state` [rad, m], or why there are none."""
        layout = self.layout(state.names)
        if layout.reason is Reason.SEVERAL_NAMES:
            return f"joint_map gives joint {layout.detail}"
        missing = [joint for joint in self._joints if joint not in layout.names]
        if missing:
            return f"joint {missing[0]} is missing"
        if len(state.position) != len(layout.names):
            return f"{len(state.position)} positions for {len(layout.names)} names"
        q = state.position[[layout.names.index(joint) for joint in self._joints]]
        return q if np.isfinite(q).all() else "a position is not finite"

    def read(
        self, layout: Layout, position: FloatArray, velocity: FloatArray, q: FloatArray, qd: FloatArray
    ) -> tuple[Reason, tuple[float, float]]:
        """Write `q` and `qd` (N, n) of N joint states; return what is wrong with their lengths.

        `layout` is that of their names, without a reason; `position` and `velocity` are (N, k), for one also (k,), as
        received.
        """
        count, positions, velocities = len(layout.names), position.shape[-1], velocity.shape[-1]
        if positions != count:
            return Reason.POSITION_COUNT, (float(positions), float(count))
        if velocities not in {0, count}:
            return Reason.VELOCITY_COUNT, (float(velocities), float(count))
        q[:] = position if layout.is_ordered else position[..., layout.order]
        if velocities:
            qd[:] = velocity if layout.is_ordered else velocity[..., layout.order]
        elif not self._from_positions:
            return Reason.NO_VELOCITY, (0.0, 0.0)
        return NONE, (0.0, 0.0)

    def filter(
        self, layout: Layout, records: NDArray[np.void], motions: FloatArray
    ) -> tuple[FloatArray, NDArray[np.bool_]] | None:
        """Filter the velocities of N `State`s as `VelocityWindow.apply`; None where they count as reported."""
        if self._window is None:
            return None
        if layout.names != self._filtered_names:
            self._window.reset()
            self._filtered_names = layout.names
        return self._window.apply(records["stamp_ns"], motions)

    def _layout_of(self, reported: tuple[str, ...]) -> Layout:  # noqa: PLR0911 - one check after the other
        names, problem = self._renamed(reported)
        nothing = np.empty(0, np.intp)

        def refused(reason: Reason, joint: int = 0, detail: str = "", value: float = 0.0) -> Layout:
            return Layout(names, nothing, False, False, reason, joint, detail, value)  # noqa: FBT003 - as named

        if problem:
            return refused(Reason.SEVERAL_NAMES, detail=problem)
        if not names:
            return refused(Reason.NO_NAMES)
        if "" in names:
            return refused(Reason.EMPTY_NAME, value=float(names.index("")))
        others = self._others(reported, names)
        index_of = {name: index for index, name in enumerate(names)}
        if len(index_of) != len(names):
            twice = next(name for index, name in enumerate(names) if index_of[name] != index)
            mapped = dict.fromkeys(old for old, name in zip(reported, names, strict=True) if name == twice)
            if len(mapped) > 1:
                return refused(Reason.SEVERAL_NAMES, detail=f"{', '.join(mapped)} the same name: {twice}")
            return refused(Reason.NAMED_TWICE, detail=twice)
        missing = [index for index, joint in enumerate(self._joints) if joint not in index_of]
        if len(missing) == len(self._joints):
            return Layout(names, nothing, is_ordered=False, is_foreign=True, others=others)
        if missing:
            return refused(Reason.MISSING_JOINT, missing[0], suggested_map(names, self._joints))
        foreign = [names[index] for index in others if self._continues(names[index])]
        if foreign:
            return refused(Reason.OTHER_ARM, detail=", ".join(foreign[:MAX_NAMES]))
        order = np.array([index_of[joint] for joint in self._joints])
        return Layout(names, order, names == self._joints, is_foreign=False, others=others)

    def _others(self, reported: Sequence[str], names: Sequence[str]) -> tuple[int, ...]:
        """Return the places of joints outside the model that neither `ignored_joints` nor the robot file excuse."""
        joints, others = set(self._joints), list[int]()
        for index, pair in enumerate(zip(reported, names, strict=True)):
            if pair[1] in joints:
                continue
            globs = self._ignored_by(pair)
            self.matched |= globs
            if not globs and pair[1] not in self._harmless:
                others.append(index)
        return tuple(others)

    def _ignored_by(self, names: Iterable[str]) -> set[str]:
        """Return the patterns of `ignored_joints` that fit one of the `names`."""
        return {glob for glob in self._ignored if any(fnmatchcase(name, glob) for name in names)}

    def _continues(self, name: str) -> bool:
        """Return whether `name` continues the numbers of the robot's joints, as joint5 does after joint1 to joint4."""
        return name not in self._held and _numbered(name) in self._series

    def _renamed(self, names: Sequence[str]) -> tuple[tuple[str, ...], str]:
        """Return the robot's names, or none and which name fits several."""
        renamed = []
        for name in names:
            matches = [(match, new) for pattern, new in self._map if (match := pattern.fullmatch(name))]
            choices = sorted({match.expand(new) for match, new in matches} or {name})
            if len(choices) > 1:
                return (), f"{name} several names: {', '.join(choices)}"
            renamed += choices
        return tuple(renamed), ""


def _numbered(name: str) -> str:
    """Return `name` with its last number replaced."""
    return re.sub(r"\d+(?=\D*$)", "#", name)


def suggested_map(reported: Sequence[str], joints: Sequence[str]) -> str:
    """Return "; try joint_map a=b,..." from the most similar names; empty unless each joint has one of its own.

    Empty also if the other names continue the numbers of these: then it is an arm with more joints.
    """
    if not reported or len(reported) > MAX_NAMES:
        return ""
    pairs: dict[str, str] = {}
    for joint in joints:
        ranked = sorted(((SequenceMatcher(None, name, joint).ratio(), name) for name in reported), reverse=True)
        (ratio, best), (second, _) = (*ranked, (0.0, ""))[:2]
        if ratio < MIN_SIMILARITY or ratio == second or best in pairs:
            return ""
        pairs[best] = joint
    if {_numbered(name) for name in pairs} & {_numbered(name) for name in reported if name not in pairs}:
        return ""
    return f"; try joint_map {','.join(f'{name}={joint}' for name, joint in pairs.items() if name != joint)}"
