# SPDX-License-Identifier: Apache-2.0
"""Joint states from CSV files by a mapping file."""

from pathlib import Path

import numpy as np
import pytest

from scara_effmass.bags.files import open_bag
from scara_effmass.errors import BagError, SettingsError
from scara_effmass.importers.joint_states import ImportedJointStates, write_joint_state_bag
from scara_effmass.values import JointState

EXAMPLES = Path(__file__).parents[2] / "examples" / "joint_csv"
MAPPING = """
time: t
time_unit: ms
joints:
  joint1: {position: a, velocity: va, unit: deg}
  joint2: {position: b, velocity: vb, unit: mrad}
  joint3: {position: c, velocity: vc, unit: mm}
"""
HEADER = "t,a,b,c,va,vb,vc"
NUMBERED = "time: 0\nheader: false\njoints: {joint1: {position: 1}}"


def states_of(tmp_path: Path, text: str, mapping: str | Path = MAPPING) -> tuple[ImportedJointStates, list[JointState]]:
    """Return what was imported, and the joint states of the bag."""
    (tmp_path / "log.csv").write_text(text, encoding="utf-8")
    if isinstance(mapping, str):
        (tmp_path / "map.yaml").write_text(mapping, encoding="utf-8")
        mapping = tmp_path / "map.yaml"
    imported = write_joint_state_bag(tmp_path / "log.csv", mapping, tmp_path / "out.mcap", overwrite=True)
    with open_bag(tmp_path / "out.mcap") as bag:
        blocks = list(bag.joint_state_blocks("/joint_states"))
        assert all((block.log_time_ns == block.stamp_ns).all() for block in blocks)
        return imported, [state for block in blocks for state in block.states()]


def test_units_become_si_and_times_that_begin_at_zero_are_shifted(tmp_path: Path) -> None:
    imported, (first, second) = states_of(tmp_path, f"{HEADER}\n0,180,500,20,90,-100,5\n\n4.5,181,501,21,91,-99,6\n")
    assert imported == ImportedJointStates(2, 1.0, 1.0045, 1.0, has_velocity=True, rows_without_values=0)
    assert (first.stamp_ns, second.stamp_ns) == (1_000_000_000, 1_004_500_000)
    assert first.names == ("joint1", "joint2", "joint3")
    np.testing.assert_allclose(first.position, [np.pi, 0.5, 0.02], rtol=1e-15)
    np.testing.assert_allclose(second.velocity, [np.radians(91), -0.099, 0.006], rtol=1e-15)


def test_log_of_rtde_and_of_topic_echo_by_the_examples(tmp_path: Path) -> None:
    columns = [f"actual_{kind}_{i}" for kind in ("q", "qd") for i in range(6)]
    rows = [" ".join(["timestamp", *columns]), " ".join(map(str, [1234.5, *range(12)]))]
    _, (state,) = states_of(tmp_path, "\n".join(rows), EXAMPLES / "ur_rtde.yaml")
    assert (state.stamp_ns, state.names[2]) == (1_234_500_000_000, "elbow_joint")
    assert (state.position.tolist(), state.velocity.tolist()) == ([*range(6)], [*range(6, 12)])

    line = "1767225600,123456789,base,joint1,joint2,joint3,joint4,0.1,0.2,0.3,0.4,1.1,1.2,1.3,1.4,9,9,9,9"
    _, (state,) = states_of(tmp_path, line, EXAMPLES / "topic_echo.yaml")
    assert (state.stamp_ns, state.names) == (1_767_225_600_123_456_789, ("joint1", "joint2", "joint3", "joint4"))
    assert (state.position.tolist(), state.velocity.tolist()) == ([0.1, 0.2, 0.3, 0.4], [1.1, 1.2, 1.3, 1.4])


def test_positions_alone_give_no_velocity(tmp_path: Path) -> None:
    imported, (state,) = states_of(tmp_path, "t,a\n5,1", "time: t\njoints: {joint1: {position: a}}")
    assert not imported.has_velocity
    assert (state.position.tolist(), len(state.velocity)) == ([1.0], 0)


@pytest.mark.parametrize(
    ("text", "mapping", "message"),
    [
        (f"{HEADER}\n1,x,2,3,4,5,6", MAPPING, "log.csv: line 2: must have numbers in columns"),
        (f"{HEADER},n\n1,2,3,4,5,6,7", MAPPING, "line 2: has 7 fields, the first row 8: must be as many"),
        ("1,1000000000,3", NUMBERED.replace("0", "[0, 1]", 1), "line 1: 0, 1 = 1, 1000000000: must be whole seconds"),
        ("1,2,3\n1,2", NUMBERED, "log.csv: line 2: has 2 fields, the first row 3: must be as many"),
        (f"{HEADER}\n1,1,2,3,4,5,6\n1,1,2,3,4,5,6", MAPPING, "log.csv: line 3: time: must be later"),
        ("0,1\n0,1", NUMBERED, "line 2: time: must be later than in the row before; of whole seconds, state time: ["),
        (f"{HEADER}\n1e30,1,2,3,4,5,6", MAPPING, "of 1970; time_unit of the mapping states s, ms, us or ns"),
        (HEADER, MAPPING, "log.csv: has no rows of numbers"),
        (f"{HEADER}\nms,rad,mrad,mm\n1,1,2,3,4,5,6", MAPPING, "line 2: a = rad: must be a number, or deg, as in the"),
        (f"{HEADER}\ns,deg,mrad,mm\n1,1,2,3,4,5,6", MAPPING, "line 2: t = s: must be a number, or ms, as in the map"),
        (f"{HEADER}\n1,1,,3,4,5,6", MAPPING, "log.csv: line 2: must have numbers in columns"),
        ("", MAPPING, "map.yaml: time = t: must be"),
        ("a,b,c\n1,2,3", MAPPING, "map.yaml: time = t: must be one of a, b, c; without times, state --rate HZ"),
        ("t,a,b\n1,2,3", MAPPING, "map.yaml: joints.joint3.position = c: must be one of t, a, b"),
        (HEADER, MAPPING.replace("velocity: vb, ", ""), "velocity must be given for all joints, or for none"),
        (HEADER, MAPPING.replace("deg", "degrees"), "map.yaml: joints.joint1.unit = 'degrees'"),
        (HEADER, "time: t", "map.yaml: joints: "),
        (HEADER, "- t", "map.yaml: must hold time and joints"),
        (HEADER, f"{MAPPING}delimiter: '\"'", "map.yaml: delimiter = '\"'"),
        (
            HEADER,
            MAPPING.replace("position: c", "position: -1"),
            "joints.joint3.position = -1: must be a name, or a number from 0",
        ),
        (HEADER, MAPPING.replace("position: c", "position: true"), "joints.joint3.position.int = True: "),
    ],
)
def test_error_is_one_line_and_leaves_no_bag(tmp_path: Path, text: str, mapping: str, message: str) -> None:
    with pytest.raises((BagError, SettingsError)) as error:
        states_of(tmp_path, text, mapping)
    assert message in str(error.value)
    assert "\n" not in str(error.value)
    assert not (tmp_path / "out.mcap").exists()


def test_seconds_and_nanoseconds_may_begin_before_zero(tmp_path: Path) -> None:
    imported, states = states_of(
        tmp_path, "-1,750000000,3\n0,250000000,4", NUMBERED.replace("0", "[0, 1]", 1).replace("1}", "2}")
    )
    assert imported.shift_s == 1.25
    assert [state.stamp_ns for state in states] == [1_000_000_000, 1_500_000_000]


SIMPLE = "joints:\n  joint1: {position: a}\n"


def test_constant_rate_in_place_of_times(tmp_path: Path) -> None:
    _, states = states_of(tmp_path, "a\n1\n2\n3\n", f"rate: 125\n{SIMPLE}")
    assert [state.stamp_ns for state in states] == [10**9, 10**9 + 8_000_000, 10**9 + 16_000_000]
    (tmp_path / "map.yaml").write_text(f"time: x\n{SIMPLE}", encoding="utf-8")
    imported = write_joint_state_bag(tmp_path / "log.csv", tmp_path / "map.yaml", tmp_path / "o.mcap", rate=100.0)
    assert imported.last_stamp_s == pytest.approx(1.02)
    for mapping in (SIMPLE, f"time: a\nrate: 5\n{SIMPLE}"):
        with pytest.raises(SettingsError, match="time: must be a column, or rate"):
            states_of(tmp_path, "a\n1\n", mapping)


def test_iso_times_decimal_commas_and_no_header(tmp_path: Path) -> None:
    text = "2025-01-01T10:00:00,5+01:00;0,25\n2025-01-01T10:00:01+01:00;0,5\n"
    (tmp_path / "map.yaml").write_text('time: 0\ndelimiter: ";"\njoints:\n  joint1: {position: 1}\n', encoding="utf-8")
    (tmp_path / "log.csv").write_text(text, encoding="utf-8")
    write_joint_state_bag(tmp_path / "log.csv", tmp_path / "map.yaml", tmp_path / "o.mcap", header=False)
    with open_bag(tmp_path / "o.mcap") as bag:
        states = [state for block in bag.joint_state_blocks() for state in block.states()]
    assert [(state.stamp_ns, state.position[0]) for state in states] == [
        (1_735_722_000_500_000_000, 0.25),
        (1_735_722_001_000_000_000, 0.5),
    ]


def test_decimal_commas_between_commas_are_refused(tmp_path: Path) -> None:
    with pytest.raises(BagError, match="has 4 fields, the first row 2: must be as many"):
        states_of(tmp_path, "t,a\n0,5,1,5\n", f"time: t\n{SIMPLE}")


def test_a_first_line_for_excel_is_no_header(tmp_path: Path) -> None:
    imported, states = states_of(tmp_path, "sep=,\nt,a\n1,0.5\n2,0.5\n", f"time: t\n{SIMPLE}")
    assert (imported.joint_states, states[0].position[0]) == (2, 0.5)
    with pytest.raises(BagError, match="line 3: must have numbers in columns"):
        states_of(tmp_path, "sep=,\nt,a\n1,x\n", f"time: t\n{SIMPLE}")


def test_times_of_day_continue_after_midnight(tmp_path: Path) -> None:
    imported, _ = states_of(tmp_path, "t,a\n23:59:59.5,1\n00:00:00.5,1\n", f"time: t\n{SIMPLE}")
    assert (imported.first_stamp_s, imported.last_stamp_s) == (86_399.5, 86_400.5)


@pytest.mark.parametrize(
    "header",
    ["# exported\n# 2025\nt,a", "# t,a", "Robot: UR5\n\nt,a", "#t,a", "t,a\ns,rad", "t,a\n[s],[Radian]", "t,a\n,rad"],
)
def test_comments_above_the_header_and_units_below_it(tmp_path: Path, header: str) -> None:
    imported, states = states_of(tmp_path, f"{header}\n1,0.5\n2,0.25\n", f"time: t\n{SIMPLE}")
    assert (imported.first_stamp_s, [state.position[0] for state in states]) == (1.0, [0.5, 0.25])


@pytest.mark.parametrize("header", [" t    a ", "# t a", "t\ta", "t \t a"])
def test_columns_between_white_space(tmp_path: Path, header: str) -> None:
    text = f"{header}\n  1.0     0.5  \n 10.0 \t -0.25\n"
    _, states = states_of(tmp_path, text, f'time: t\ndelimiter: " "\n{SIMPLE}')
    assert [state.position[0] for state in states] == [0.5, -0.25]


def test_rows_of_other_topics_are_left_out_and_counted(tmp_path: Path) -> None:
    """PlotJuggler writes a row for each time of any topic."""
    imported, states = states_of(tmp_path, "t,a,force\n1,0.5,\n1.5,,7\n2,0.25,\n", f"time: t\n{SIMPLE}")
    assert (imported.joint_states, imported.rows_without_values) == (2, 1)
    assert [state.position[0] for state in states] == [0.5, 0.25]


@pytest.mark.parametrize("per_s", [1e3, 1e6, 1.0 / 86_400.0])
def test_times_that_are_no_seconds_need_their_unit(tmp_path: Path, per_s: float) -> None:
    """Milliseconds read as seconds make a robot slow; days, as MATLAB and Excel count them, make it fast."""
    text = "t,a\n" + "".join(f"{n / 125.0 * per_s:.15g},0.5\n" for n in range(20))
    with pytest.raises(
        SettingsError, match=r"map.yaml: time_unit: must be stated \(s, ms, us or ns\): .*log.csv would"
    ):
        states_of(tmp_path, text, f"time: t\n{SIMPLE}")
    assert not (tmp_path / "out.mcap").exists()
    imported, _ = states_of(tmp_path, text, f"time: t\ntime_unit: s\n{SIMPLE}")
    assert imported.joint_states == 20
