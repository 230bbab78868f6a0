# SPDX-License-Identifier: Apache-2.0
"""`scara-effmass monitor`, `daq`, `validator`, `speed_scaling`, `sim` and `visualization`: run one node."""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scara_effmass.settings import MonitorSettings, ValidatorSettings, checked, load_settings

if TYPE_CHECKING:
    from scara_effmass.impacts.validator import Result
    from scara_effmass.nodes.validator_node import NodeSettings


def run(args: argparse.Namespace) -> int:
    """Run the node of `args.command` until it is stopped."""
    options = vars(args).copy()
    quiet, verbose = options.pop("quiet"), options.pop("verbose")
    name, ros_arguments, params = options.pop("command"), options.pop("ros_arguments"), options.pop("params", None)
    node = import_module(f"scara_effmass.nodes.{name}_node")
    if params:
        # One error line, where ROS would print ten; the node knows its namespace.
        load_settings(node.NodeSettings, params, name, of_one_cell=False)
    if verbose:
        options["status_period"] = 1.0
    level = ["--ros-args", "--log-level", "warn", "--"] if quiet else []
    arguments = [*level, *node_arguments(params, options, ros_arguments)]
    code: int = node.main(arguments, write_report) if name == "validator" else node.main(arguments)
    return code


def validator_node() -> int:
    """Run `validator_node` as a ROS executable, with the arguments of the process."""
    from scara_effmass.nodes.validator_node import main  # noqa: PLC0415 - rclpy, only when the node runs

    return main(None, write_report)


def node_arguments(params: Path | None, parameters: Mapping[str, Any], ros_arguments: Sequence[str]) -> list[str]:
    """Return ROS arguments: parameter file, `parameters`, and the arguments of the user, which override both."""
    arguments = ["--ros-args"]
    if params:
        arguments += ["--params-file", str(params)]
    for name, value in parameters.items():
        if value is not None and value != "":
            # ROS parses the value as YAML: unquoted, some file names would become numbers.
            arguments += ["-p", f"{name}:={json.dumps(value)}"]
    return [*arguments, "--", *ros_arguments]


def write_report(result: Result, settings: NodeSettings, folder: Path) -> Path:
    """Write the report of a live series; return the path of its page. Raises OutputError, RobotError."""
    from scara_effmass.analysis import validation_report  # noqa: PLC0415 - draws, only when it is asked for
    from scara_effmass.analysis.report import PAGE  # noqa: PLC0415
    from scara_effmass.analysis.validation import Validation, ValidationSettings  # noqa: PLC0415
    from scara_effmass.model.load import load_robot  # noqa: PLC0415

    monitor = checked(MonitorSettings, {"robot": settings.robot}, "validator")
    validator = checked(
        ValidatorSettings, settings.model_dump(include=set(ValidatorSettings.model_fields)), "validator"
    )
    report_settings = ValidationSettings(monitor=monitor, validator=validator, detection=settings.detection)
    robot = load_robot(monitor.robot_path, monitor)
    validation_report.write_report(
        Validation(result, (), no_motion="the series was live"), report_settings, robot, folder, overwrite=False
    )
    return folder / PAGE
