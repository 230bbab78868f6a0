# SPDX-License-Identifier: Apache-2.0
"""The figure of a run shows every line, verdict, gap and impact with its label."""

from collections import Counter
from io import BytesIO

import numpy as np
from matplotlib.figure import Figure
from matplotlib.image import imread

from scara_effmass.analysis.forces import RecordedForce
from scara_effmass.analysis.report import report_figure
from scara_effmass.analysis.run_report import draw_run
from scara_effmass.analysis.time_series import ROW, TimeSeries, TimeSeriesBuilder
from scara_effmass.safety import unknown_contact
from scara_effmass.values import Impact, Verdict
from test.decisions import decision_on, states_of


def run(seconds: float = 10.0, *, max_mass: float = 3.0, full: bool = True, gap: bool = False) -> TimeSeries:
    """Return a time series at 1 kHz with a spike of a single cycle in speed and mass."""
    t = np.arange(0.0, seconds, 1e-3)
    t = t[(t < 4.0) | (t > 6.0)] if gap else t
    mass = 1.5 + 0.5 * np.cos(t)
    speed = 0.5 + 0.3 * np.sin(t)
    speed[len(t) // 3], mass[len(t) // 3] = 2.0, max_mass
    rows = np.zeros(len(t), ROW)
    rows["stamp_ns"] = np.rint(t * 1e9)
    rows["verdict"] = np.where(speed > 1.0, Verdict.VIOLATION, Verdict.OK)
    rows["speed"], rows["allowable_speed"], rows["margin"] = speed, 1.0, 1.0 - speed
    rows["effective_mass"] = rows["lumped_mass"] = mass
    rows["full_mass"], rows["iso_mass"] = 0.9 * mass if full else np.nan, 2.77
    return TimeSeries({}, Counter(), ("",), rows)


def draw(series: TimeSeries, model: str = "lumped") -> Figure:
    return draw_run(series, title="a robot: a bag", subtitle="generated", mass_model=model, timeout=0.2)


def lines(figure: Figure, panel: int) -> dict[str, np.ndarray[tuple[int, ...], np.dtype[np.float64]]]:
    return {str(line.get_label()): np.asarray(line.get_ydata()) for line in figure.axes[panel].get_lines()}


def test_axes_have_units_and_lines_have_labels() -> None:
    figure = draw(run())
    assert [axes.get_ylabel() for axes in figure.axes] == [
        "verdict",
        "speed of the contact point [m/s]",
        "effective mass [kg]",
    ]
    assert figure.axes[-1].get_xlabel().endswith("[s]")
    assert set(lines(figure, 1)) == {"allowable speed", "speed", "speed above the allowable"}
    assert set(lines(figure, 2)) == {"lumped model (decides)", "full model", "ISO, M/2 + m_L"}
    assert all(axes.get_legend() for axes in figure.axes)


def test_peak_of_one_cycle_is_drawn() -> None:
    figure = draw(run(100.0))
    assert np.nanmax(lines(figure, 1)["speed"]) == 2.0
    assert np.nanmax(lines(figure, 2)["lumped model (decides)"]) == 3.0
    assert len(lines(figure, 1)["speed"]) < 10_000


def test_wide_mass_range_has_a_logarithmic_axis() -> None:
    assert draw(run()).axes[2].get_yscale() == "linear"
    assert draw(run(max_mass=900.0)).axes[2].get_yscale() == "log"


def test_gap_breaks_the_lines() -> None:
    assert not np.isnan(lines(draw(run()), 1)["speed"]).any()
    assert np.isnan(lines(draw(run(gap=True)), 1)["speed"]).sum() == 1


def test_missing_mass_model_is_not_in_the_legend() -> None:
    assert "full model" not in lines(draw(run(full=False)), 2)
    assert "full model (decides)" in lines(draw(run(), "full"), 2)
    assert "largest (decides)" in lines(draw(run(), "largest"), 2)


def test_single_unknown_cycle_is_drawn() -> None:
    builder = TimeSeriesBuilder()
    builder.add(states_of(decision_on(unknown_contact("tool", "the joint state is old")), log_time_ns=1), 0)
    figure = report_figure("run", "", "", draw(builder.build()))
    height, width, _ = imread(BytesIO(figure.png)).shape
    assert width > 1500
    assert height > 900
    assert figure.svg.rstrip().endswith(b"</svg>")


def test_force_panel_shows_force_and_impacts() -> None:
    stamp_ns = (np.arange(100) * 1e8).astype(np.int64)
    impact = Impact(5_000_000_000, "cell", 90.0, 2e-3, 0.1, 640.0, *(False, False, 0, 0.0, 0.1, 0.0, "test", False))
    clipped = impact._replace(stamp_ns=7_000_000_000, peak_force=40.0, clipped=True, load_force=25.0)
    forces = RecordedForce(stamp_ns, np.linspace(0.0, 90.0, 100), simulated=True, impacts=(impact, clipped))
    figure = draw_run(run(), title="", subtitle="", mass_model="lumped", timeout=0.2, forces=forces)
    assert len(figure.axes) == 4
    panel = lines(figure, 3)
    assert panel["simulated force"][-1] == 90.0
    assert panel["impact"] == 90.0
    assert panel["impact, clipped or incomplete"] == 65.0  # on the load of an earlier contact
