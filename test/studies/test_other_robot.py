# SPDX-License-Identifier: Apache-2.0
"""The paper's figures for another robot: masses equal those of the models, and what is left out is said."""

import json
from pathlib import Path

import numpy as np
import pytest

from scara_effmass.errors import OutputError
from scara_effmass.model.load import load_robot
from scara_effmass.reference import RobotDynamics
from scara_effmass.safety import Monitor
from scara_effmass.settings import MonitorSettings
from scara_effmass.share import share
from scara_effmass.studies.other_robot import LEFT_OUT, NUMBERS, RobotMasses, make_figures
from scara_effmass.studies.scara import scara_lumped_mass


def monitor(robot: Path) -> Monitor:
    settings = MonitorSettings(robot=str(robot))
    return Monitor(RobotDynamics(load_robot(robot, settings)), settings)


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def test_figures_of_a_scara(tmp_path: Path) -> None:
    watched = monitor(share("config", "omron_i4_550l.yaml"))
    masses = RobotMasses(watched, samples=300)
    expected = scara_lumped_mass(masses.sample.q[:, 0], masses.sample.q[:, 1], 0.0, 2.38, 0.97)
    np.testing.assert_allclose(masses.masses["lumped"], expected, rtol=1e-4)
    summary = make_figures(watched, tmp_path, overwrite=False, advance=lambda _: None, samples=100)
    figures = {f"figure_{number}.{end}" for number in NUMBERS for end in ("png", "svg")}
    assert names(tmp_path) == figures | {"index.html", "figures.json"}
    assert json.loads((tmp_path / "figures.json").read_text(encoding="utf-8")) == summary
    assert summary["left_out"] == LEFT_OUT
    with pytest.raises(OutputError, match="already exists"):
        make_figures(watched, tmp_path, overwrite=False, advance=lambda _: None, samples=100)


@pytest.mark.usefixtures("unrendered")
def test_robot_without_a_simplified_model_has_no_error_of_it(tmp_path: Path) -> None:
    watched = monitor(share("config", "robots", "panda.urdf"))
    masses = RobotMasses(watched, samples=100)
    assert set(masses.masses) == {"full"}
    # The sampled motion is along x: the monitor's own mass.
    np.testing.assert_allclose(masses.masses["full"], masses.sample.masses("full_mass"), rtol=1e-3)
    summary = make_figures(watched, tmp_path, overwrite=False, advance=lambda _: None, samples=100)
    assert "figure_9" not in summary["figures"]
    page = (tmp_path / "index.html").read_text(encoding="utf-8")
    assert "mm off the plane of its two axes" in summary["left_out"]["Figs. 9 and 11"]
    assert all(reason.split("'")[0] in page for reason in summary["left_out"].values())


@pytest.mark.usefixtures("unrendered")
def test_robot_without_inertias_has_the_simplified_model_only(tmp_path: Path) -> None:
    without_inertia = monitor(Path(__file__).parents[1] / "robots" / "scara_icube_tutorial.urdf")
    summary = make_figures(without_inertia, tmp_path, overwrite=False, advance=lambda _: None, samples=100)
    assert (summary["model"], bool(without_inertia.dynamics.full_reason)) == ("lumped", True)
    assert without_inertia.dynamics.full_reason in summary["left_out"]["Figs. 9 and 11"]
