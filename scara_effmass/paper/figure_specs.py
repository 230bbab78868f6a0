"""The paper's figures: number, caption, drawing function and required inputs of each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from matplotlib.figure import Figure

from scara_effmass.paper.density import figure_8
from scara_effmass.paper.experiment import figure_17, figure_18, figure_19
from scara_effmass.paper.mass_maps import figure_6, figure_9, figure_12, figure_14, figure_15
from scara_effmass.paper.protocol import SHOWN_OBSTACLE_KG
from scara_effmass.paper.recorded_impact import RecordedImpact
from scara_effmass.paper.scara import Scara
from scara_effmass.paper.schematic import figure_7
from scara_effmass.paper.slices import figure_10, figure_11

if TYPE_CHECKING:
    from scara_effmass.model.dynamics import RobotDynamics
    from scara_effmass.paper.motion import ToolMotion


@dataclass(frozen=True, slots=True)
class FigureInputs:
    """Inputs of the figures; without `runs` no force is drawn."""

    dynamics: RobotDynamics
    scara: Scara
    motion: ToolMotion
    runs: tuple[RecordedImpact, ...] = ()

    @property
    def no_forces(self) -> str:
        """Reason why no force can be drawn, or empty."""
        return "" if self.runs else "no recorded impacts were given"

    @property
    def no_figure_18(self) -> str:
        """Reason why Fig. 18 cannot be drawn, or empty."""
        if self.runs and all(run.obstacle_mass_kg != SHOWN_OBSTACLE_KG for run in self.runs):
            return f"no recorded impact has m_H = {SHOWN_OBSTACLE_KG:g} kg"
        return self.no_forces


class FigureSpec(NamedTuple):
    """A figure of the paper; `missing` and `part_missing` return why it is not drawn, or not all of it."""

    number: int
    draw: Callable[[FigureInputs], Figure]
    caption: str
    missing: Callable[[FigureInputs], str] = lambda _: ""
    part_missing: Callable[[FigureInputs], str] = lambda _: ""

    @property
    def name(self) -> str:
        """Base name of its files."""
        return f"figure_{self.number}"


GRID_NOTE = "50 by 50 angles over the joint ranges, as in the paper."
FIGURE_SPECS = (
    FigureSpec(
        6,
        figure_6,
        "Effective mass of the simplified model (Eq. 28) over the workspace (a) and over q₁ and q₂ (b). Red: contour "
        f"of the standard's m_R. {GRID_NOTE} The mass is unbounded towards the stretched arm along n; the colours end "
        "at 6 kg.",
    ),
    FigureSpec(
        7,
        figure_7,
        "A pose of smallest effective mass (a), and one of largest effective mass at its q₂ (b), with M₂ at the elbow "
        "and M₃ at the tool. The angles are chosen here.",
    ),
    FigureSpec(
        8,
        figure_8,
        "Effective mass at 2500 positions that each represent the same area of the workspace; the line is the whole "
        "workspace. The mean depends on the few largest values, hence on the number of positions.",
    ),
    FigureSpec(
        9,
        figure_9,
        f"Error of the simplified model (Eq. 28) against the full one (Eq. 27) in effective mass. {GRID_NOTE} The full "
        "model's inertias are fitted to the paper's numbers, so the pattern is one of several possible.",
    ),
    FigureSpec(
        10,
        figure_10,
        "Reduced mass of the simplified model, one slice per obstacle mass, evenly spaced. Red: µ_ISO. The colours end "
        "at 4 kg; µ itself ends at m_H.",
    ),
    FigureSpec(
        11,
        figure_11,
        "Error of the simplified model against the full one in reduced mass, one slice per obstacle mass.",
    ),
    FigureSpec(
        12,
        figure_12,
        "Reduced mass along y (a) and along (0.6, 0.8, 0) (b). Red: µ_ISO. The values turn with the normal, the "
        "outline of the workspace does not.",
    ),
    FigureSpec(
        14,
        figure_14,
        "Reduced mass of the left arm: the right arm's, mirrored in the x axis. The paper's text does not give m_H "
        "here; 2.39 kg is its representative case.",
    ),
    FigureSpec(
        15,
        figure_15,
        "The smaller reduced mass of both arms; where only one arm reaches, that of this arm, hence the edges in the "
        "colours. Positions on 200 circles and 721 rays.",
    ),
    FigureSpec(
        17,
        figure_17,
        "Position and velocity of the tool along x around the impact point (300, 200) mm. The velocity drops again "
        "where the robot, which follows its planned path, catches up with the cart and hits it again.",
    ),
    FigureSpec(
        18,
        figure_18,
        "Force over time in each configuration, one line per repetition, from the first contact of each run.",
        missing=lambda inputs: inputs.no_figure_18,
    ),
    FigureSpec(
        19,
        figure_19,
        "Mean peak force (a) and √µ of the simplified model (b) by configuration, one curve per obstacle mass. Of the "
        "three impact points only (300, 200) mm is in the paper's text; the others are chosen here.",
        part_missing=lambda inputs: inputs.no_forces and f"(a): {inputs.no_forces}",
    ),
)
"""Parts (a) and (b) are in one figure. Figs. 1 to 5, 13 and 16 are drawings and photographs."""
