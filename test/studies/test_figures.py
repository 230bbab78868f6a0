# SPDX-License-Identifier: Apache-2.0
"""Every figure has titles and units, nothing is cut off, and the red line is at the standard's value.

Figures, page and claims are written together and reproducibly; the page is self-contained.
"""

import json
from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.contour import QuadContourSet
from matplotlib.figure import Figure

from scara_effmass.analysis.report import ISO_RED, STYLE
from scara_effmass.errors import OutputError
from scara_effmass.iso15066 import reduced_mass
from scara_effmass.sim.motion import ElbowConfig, inverse_kinematics
from scara_effmass.studies.figures import FIGURES, DrawFigure, figure_18, figure_19, make_figure_set
from scara_effmass.studies.runs import FigureInputs
from scara_effmass.studies.scara import Scara
from scara_effmass.values import FloatArray
from test.analysis.conftest import Page

BY_NUMBER = {int(draw.__name__.removeprefix("figure_")): draw for draw in FIGURES}


def draw(number: int, inputs: FigureInputs) -> Figure:
    with mpl.rc_context(STYLE):
        figure = BY_NUMBER[number](inputs)
        figure.draw_without_rendering()
    return figure


def red_line(axes: Axes) -> FloatArray:
    """Return the points (n, 2) of the red contour on `axes`."""
    contours = [item for item in axes.collections if isinstance(item, QuadContourSet) and not item.filled]
    (line,) = (item for item in contours if to_hex(np.asarray(item.get_edgecolor())[0].tolist()) == ISO_RED.lower())
    return np.concatenate([path.vertices for path in line.get_paths()])


def test_figures_are_those_of_the_paper() -> None:
    assert list(BY_NUMBER) == [6, 7, 8, 9, 10, 11, 12, 14, 15, 17, 18, 19]
    assert all(caption.endswith(".") for caption in FIGURES.values())


@pytest.mark.parametrize("number", BY_NUMBER)
def test_figure_is_labelled_and_not_cut_off(number: int, inputs: FigureInputs) -> None:
    figure = draw(number, inputs)
    assert figure.get_suptitle().startswith(f"Fig. {number} ")
    for axes in figure.axes:
        labels = [axes.get_ylabel()] if axes.get_label() == "<colorbar>" else [axes.get_xlabel(), axes.get_ylabel()]
        for label in labels:
            assert label.endswith("]") or label.startswith("tool at the impact"), label
    box = figure.get_tightbbox()  # bounding box of everything [inch]
    width, height = figure.get_size_inches()
    assert min(box.x0, box.y0, width - box.x1, height - box.y1) > -0.02, "something is cut off"


def test_red_line_of_figure_6_is_at_the_iso_mass(inputs: FigureInputs) -> None:
    workspace, angles, _ = draw(6, inputs).axes
    scara = inputs.scara
    q1, q2 = np.radians(red_line(angles)).T
    np.testing.assert_allclose(scara.lumped(q1, q2), scara.iso_mass, rtol=0.06)
    q = inverse_kinematics(red_line(workspace), ElbowConfig.RIGHT)
    assert np.median(np.abs(scara.lumped(q[:, 0], q[:, 1]) / scara.iso_mass - 1.0)) < 0.01


@pytest.mark.parametrize(("panel", "phi"), [(0, np.pi / 2.0), (1, np.arctan2(0.8, 0.6))])
def test_red_line_of_figure_12_is_at_the_iso_reduced_mass(inputs: FigureInputs, panel: int, phi: float) -> None:
    axes = draw(12, inputs).axes[panel]
    assert_on_mu_iso(inputs.scara, red_line(axes), ElbowConfig.RIGHT, phi)


def test_figure_14_shows_the_left_arm(inputs: FigureInputs) -> None:
    workspace, angles, _ = draw(14, inputs).axes
    assert angles.get_ylim() == pytest.approx((-148.0, 0.0), abs=0.01)
    assert_on_mu_iso(inputs.scara, red_line(workspace), ElbowConfig.LEFT, 0.0)


def test_figure_15_shows_the_smaller_reduced_mass(inputs: FigureInputs) -> None:
    axes = draw(15, inputs).axes[0]
    scara = inputs.scara
    iso = reduced_mass(scara.iso_mass, 2.39)
    points = red_line(axes)
    both = []
    for elbow_config in ElbowConfig:
        q = inverse_kinematics(points, elbow_config)
        mu = reduced_mass(scara.lumped(q[:, 0], q[:, 1]), 2.39)
        both.append(np.where(np.abs(q[:, 0]) <= scara.q1_max, mu, np.inf))
    assert np.median(np.abs(np.minimum(*both) / iso - 1.0)) < 0.01


def assert_on_mu_iso(scara: Scara, points: FloatArray, elbow_config: ElbowConfig, phi: float) -> None:
    q = inverse_kinematics(points, elbow_config)
    mu = reduced_mass(scara.lumped(q[:, 0], q[:, 1], phi), 2.39)
    assert np.median(np.abs(mu / reduced_mass(scara.iso_mass, 2.39) - 1.0)) < 0.01


def test_figure_17_shows_the_impact_at_300_mm(shipped: FigureInputs) -> None:
    figure = draw(17, shipped)
    position, velocity = figure.axes
    onset = float(np.asarray(position.get_lines()[1].get_xdata())[0]) - 1e-3
    for axes, expected in ((position, 300.0), (velocity, 250.0)):
        line = axes.get_lines()[0]
        shown = np.interp(onset, np.asarray(line.get_xdata()), np.asarray(line.get_ydata()))
        assert shown == pytest.approx(expected, rel=5e-3)
    assert "simulated run 300_200_2390g_1" in figure.get_suptitle()


def test_titles_state_simulated_or_measured(inputs: FigureInputs) -> None:
    for kind, flag in (("simulated", True), ("measured", False)):
        with_runs = replace(inputs, runs=tuple(replace(run, simulated=flag) for run in inputs.runs))
        assert kind in draw(18, with_runs).get_suptitle()
        assert kind in draw(19, with_runs).axes[0].get_title("left")


def test_figure_18_shows_every_repetition_of_one_obstacle(inputs: FigureInputs) -> None:
    (axes,) = draw(18, inputs).axes
    assert len(axes.get_lines()) == 9
    peaks = sorted(float(np.max(line.get_ydata())) for line in axes.get_lines())
    expected = sorted(float(run.force.max()) for run in inputs.runs if run.obstacle_mass == 2.39)
    assert peaks == pytest.approx(expected)


def test_figure_19_shows_mean_forces_and_roots(inputs: FigureInputs) -> None:
    forces, roots = draw(19, inputs).axes
    for measured, predicted in zip(forces.get_lines(), roots.get_lines(), strict=True):
        ratio = np.divide(measured.get_ydata(), predicted.get_ydata())
        np.testing.assert_allclose(ratio, 250.0)  # v sqrt(k) of the synthetic impacts
    assert [line.get_label() for line in roots.get_lines()] == ["7.35", "3.72", "2.39", "0.50"]


def test_campaign_of_other_cases_is_drawn(inputs: FigureInputs) -> None:
    runs = tuple(replace(run, point=(0.25, 0.1), obstacle_mass=2.0) for run in inputs.runs[:2])
    other = replace(inputs, runs=runs)
    assert "$m_H$ = 2 kg" in draw(18, other).get_suptitle()
    assert draw(17, other).axes
    assert draw(19, other).axes


FEW: dict[DrawFigure, str] = {draw: FIGURES[draw] for draw in (figure_18, figure_19)}
FILES = {"figure_18.png", "figure_18.svg", "figure_19.png", "figure_19.svg", "index.html", "claims.json"}


def write_set(
    inputs: FigureInputs, folder: Path, *, overwrite: bool = False, captions: dict[DrawFigure, str] = FEW
) -> dict[str, bytes]:
    make_figure_set(inputs, folder, overwrite=overwrite, advance=lambda: None, captions=captions)
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.fixture(scope="module")
def files(inputs: FigureInputs, tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    return write_set(inputs, tmp_path_factory.mktemp("figures"))


def test_repeated_figure_set_gives_the_same_files(
    files: dict[str, bytes], inputs: FigureInputs, tmp_path: Path
) -> None:
    assert set(files) == FILES
    assert files == write_set(inputs, tmp_path)


def test_page_is_complete_and_self_contained(files: dict[str, bytes]) -> None:
    text = files["index.html"].decode()
    page = Page(text)
    assert page.open == []
    assert [address[:22] for address in page.addresses] == 2 * ["data:image/png;base64,"]
    assert all(picture["alt"] for picture in page.pictures)
    assert "url(" not in text
    assert "@import" not in text
    result = json.loads(files["claims.json"])
    assert page.rows == len(result["claims"]) + 1
    assert result["figures"] == ["figure_18", "figure_19"]
    assert sum(result["counts"].values()) == len(result["claims"])
    assert max(result["closed_form_check"][f"{model}_relative_difference"] for model in ("lumped", "full")) < 1e-9


@pytest.mark.usefixtures("unrendered")
def test_existing_file_is_replaced_only_with_overwrite(inputs: FigureInputs, tmp_path: Path) -> None:
    (tmp_path / "claims.json").write_text("mine")
    with pytest.raises(OutputError, match=r"claims\.json: already exists"):
        write_set(inputs, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["claims.json"]
    assert (tmp_path / "claims.json").read_text() == "mine"
    assert write_set(inputs, tmp_path, overwrite=True)["claims.json"] != b"mine"


def test_failed_drawing_leaves_no_files(inputs: FigureInputs, tmp_path: Path) -> None:
    def fail(_: FigureInputs) -> Figure:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_set(inputs, tmp_path, captions={**FEW, fail: "Never drawn."})
    assert list(tmp_path.iterdir()) == []
