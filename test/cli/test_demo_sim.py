# SPDX-License-Identifier: Apache-2.0
"""`demo`: all nodes live on the simulated cell, and the report of their impacts."""

import json
from argparse import Namespace
from pathlib import Path

import pytest

from scara_effmass.cli import make_parser
from scara_effmass.cli.options import monitor_settings
from scara_effmass.cli.processes import commands, dashboard_command
from test.cli.conftest import Cli


def test_dashboard_starts_where_somebody_sees_it(monkeypatch: pytest.MonkeyPatch) -> None:
    args = make_parser().parse_args(["demo", "--contact-point", "elbow", "--contact-point", "tip=link4: 0 0 0"])
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    assert dashboard_command(args) == ([], "not started: there is no display and no terminal")
    monkeypatch.setenv("WAYLAND_DISPLAY", "wayland-0")
    command, text = dashboard_command(args)
    assert command[:3] == ["dashboard", "--open", "--port"]
    assert text == f"http://127.0.0.1:{command[3]}/ until the demo ends"
    assert command[4:] == ["--contact-point=elbow", "--contact-point=tip=link4: 0 0 0"]
    monkeypatch.setattr("scara_effmass.cli.processes.find_spec", lambda _: None)
    assert dashboard_command(args) == ([], "needs NiceGUI: pip install 'scara_effmass[dashboard]'")


def test_every_live_impact_is_in_the_recording(cli_process: Cli, tmp_path: Path, domain: dict[str, str]) -> None:
    """With a dashboard in a browser, which is a program that notes the address."""
    browser = tmp_path / "browser"
    browser.write_text(f'#!/bin/sh\necho "$1" > {tmp_path}/opened\n', encoding="utf-8")
    browser.chmod(0o755)
    domain |= {"DISPLAY": ":99", "BROWSER": str(browser)}
    done = cli_process("demo", "--duration", "3", "--out", tmp_path / "out", "--json")
    assert done.stderr == ""
    result = json.loads(done.stdout)
    # The demo waits for the first impact, and more come if the nodes end late; an accepted series needs six.
    context = result["refused"], result["unpaired"], result["recording"]
    assert 1 <= result["live"] == result["both"] <= result["offline"], context
    assert not result["accepted"] or result["offline"] >= 6
    assert done.returncode == (not result["accepted"])
    # The scalars live 2 s, the markers are the last 10, the load is the last one: a busy recorder can be later.
    lost = {name for name, topic in result["recording"]["topics"].items() if any(topic["lost"].values())}
    assert lost <= {"/allowable_speed", "/speed_scaling", "/effective_mass_markers", "/payload_estimate"}
    impact = result["impacts"][0]
    assert impact["simulated"] is True
    assert (impact["configuration"], impact["obstacle_mass"]) == ("300_200", 0.5)
    assert impact["speed"] == pytest.approx(0.25, abs=0.002)
    assert impact["measured_force"] == pytest.approx(202.6, rel=0.01)
    files = {path.name for path in (tmp_path / "out").iterdir()}
    assert (tmp_path / "opened").read_text(encoding="utf-8").startswith("http://127.0.0.1:")
    assert {"recording", "report.html", "report.json"} <= files


def test_the_markers_show_the_robot_of_the_monitor() -> None:
    options = ("--payload", "2.5", "--locked-joints", "joint4", "--contact-point", "elbow", "--person-speed", "1.6")
    args = make_parser().parse_args(["demo", *options], Namespace(ros_arguments=[]))
    _, monitor, visualization = commands(args, monitor_settings(args))
    shown = ("payload_mass:=2.5", 'locked_joints:=["joint4"]', 'contact_points:=["elbow"]')
    assert {*shown} < {*monitor}
    assert {*shown} < {*visualization}
    assert "person_speed:=1.6" not in visualization
