"""The paper's figures one by one: what each needs, what it shows, how it is drawn."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from scara_effmass.paper.density import figure_8
from scara_effmass.paper.experiment import figure_17, figure_18, figure_19
from scara_effmass.paper.mass_maps import figure_6, figure_9, figure_12, figure_14, figure_15
from scara_effmass.paper.protocol import SHOWN_OBSTACLE_KG
from scara_effmass.paper.schematic import figure_7
from scara_effmass.paper.slices import figure_10, figure_11

if TYPE_CHECKING:
    from collections.abc import Callable

    from matplotlib.figure import Figure

    from scara_effmass.model.dynamics import RobotDynamics
    from scara_effmass.paper.motion import ToolMotion
    from scara_effmass.paper.recorded_impact import RecordedImpact
    from scara_effmass.paper.scara import Scara


@dataclass(frozen=True, slots=True)
class Material:
    """What the figures are made from; without `runs`, no force is drawn."""

    dynamics: RobotDynamics
    scara: Scara
    motion: ToolMotion
    runs: tuple[RecordedImpact, ...] = ()

    @property
    def no_forces(self) -> str:
        """Why no force can be drawn; empty where it can."""
        return "" if self.runs else "no recorded impacts were given"

    @property
    def no_shown_force(self) -> str:
        """Why the force with the obstacle mass of Fig. 18 cannot be drawn; empty where it can."""
        if self.runs and all(run.obstacle_mass_kg != SHOWN_OBSTACLE_KG for run in self.runs):
            return f"no recorded impact has m_H = {SHOWN_OBSTACLE_KG:g} kg"
        return self.no_forces


class FigureSpec(NamedTuple):
    """One figure: its number in the paper, what it shows, how it is drawn, and why (perhaps in part) it is not."""

    number: int
    caption: str
    draw: Callable[[Material], Figure]
    whole_missing: Callable[[Material], str] = lambda _: ""
    part_missing: Callable[[Material], str] = lambda _: ""

    @property
    def name(self) -> str:
        """Of its files."""
        return f"figure_{self.number}"


GRID_NOTE = "50 by 50 angles over the joint ranges, as in the paper."
FIGURE_SPECS = (
    FigureSpec(
        6,
        "Effective mass of the simplified model (Eq. 28) over the workspace (a) and over q₁ and q₂ (b). Red: where it "
        f"is the standard's m_R. {GRID_NOTE} Towards the stretched arm along n the mass grows without bound; the "
        "colours end at 6 kg.",
        lambda material: figure_6(material.scara),
    ),
    FigureSpec(
        7,
        "A pose of the smallest effective mass (a), and one of the largest at its q₂ (b), with M₂ at the elbow and M₃ "
        "at the tool. The angles are chosen here.",
        lambda material: figure_7(material.scara),
    ),
    FigureSpec(
        8,
        "Effective mass at 2500 positions that each stand for the same area of the workspace; the line is that of the "
        "whole workspace. The mean depends on the few largest values, hence on how many positions there are.",
        lambda material: figure_8(material.scara),
    ),
    FigureSpec(
        9,
        f"Error of the simplified model (Eq. 28) against the full one (Eq. 27) in effective mass. {GRID_NOTE} The full "
        "model's inertias are fitted to the paper's numbers, so the pattern is one of several possible.",
        lambda material: figure_9(material.scara),
    ),
    FigureSpec(
        10,
        "Reduced mass of the simplified model, one slice for each obstacle mass (evenly spaced: to scale, two would "
        "cover each other). Red: µ_ISO. The colours end at 4 kg; µ itself ends at m_H.",
        lambda material: figure_10(material.scara),
    ),
    FigureSpec(
        11,
        "Error of the simplified model against the full one in reduced mass, one slice for each obstacle mass.",
        lambda material: figure_11(material.scara),
    ),
    FigureSpec(
        12,
        "Reduced mass along y (a) and along (0.6, 0.8, 0) (b). Red: µ_ISO. The values turn with the normal, the "
        "outline of the workspace does not.",
        lambda material: figure_12(material.scara),
    ),
    FigureSpec(
        14,
        "Reduced mass of the left arm: the right arm's, mirrored in the x axis. The paper's text does not name m_H "
        "here; 2.39 kg is its representative case.",
        lambda material: figure_14(material.scara),
    ),
    FigureSpec(
        15,
        "The smaller of both arms' reduced masses; where only one arm reaches, that arm's, hence the edges in the "
        "colours. Positions on 200 circles and 721 rays.",
        lambda material: figure_15(material.scara),
    ),
    FigureSpec(
        17,
        "Position and velocity of the tool along x around the impact point (300, 200) mm. Where the velocity drops "
        "again behind the impact, the robot, which goes on as planned, has come after the cart and hit it anew.",
        lambda material: figure_17(material.motion),
    ),
    FigureSpec(
        18,
        "Force over time in each configuration, every repetition a line. Of each run the first contact is shown.",
        lambda material: figure_18(material.scara, material.runs),
        whole_missing=lambda material: material.no_shown_force,
    ),
    FigureSpec(
        19,
        "Mean peak force (a) and √µ of the simplified model (b) by configuration, one curve for each obstacle mass. "
        "Of the three impact points only (300, 200) mm is in the paper's text; the others are chosen here.",
        lambda material: figure_19(material.scara, material.runs),
        part_missing=lambda material: material.no_forces and f"(a): {material.no_forces}",
    ),
)
"""Fig. 6 is 6 (a) and 6 (b), as the others have their parts; Figs. 1 to 5, 13 and 16 are drawings and photographs."""
