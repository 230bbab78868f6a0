# SPDX-License-Identifier: Apache-2.0
"""`scara-effmass monitor`, `daq`, `validator`, `speed_scaling`, `sim` and `visualization`: run one node."""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

from scara_effmass.errors import SettingsError
from scara_effmass.settings import load_settings


def run(args: argparse.Namespace) -> int:
    """Run the node of `args.command` until it is stopped."""
    options = vars(args).copy()
    quiet, verbose = options.pop("quiet"), options.pop("verbose")
    if quiet and verbose:
        raise SettingsError("--quiet: must be without --verbose")
    name, ros_arguments, params = options.pop("command"), options.pop("ros_arguments"), options.pop("params", None)
    node = import_module(f"scara_effmass.nodes.{name}_node")
    if params:
        # One error line, where ROS would print ten; the node knows its namespace.
        load_settings(node.NodeSettings, params, name, of_one_cell=False)
    if verbose:
        options["status_period"] = 1.0
    level = ["--ros-args", "--log-level", "warn", "--"] if quiet else []
    arguments = [*level, *node_arguments(params, options, ros_arguments)]
    code: int = node.main(arguments)
    return code


def node_arguments(params: Path | None, parameters: Mapping[str, Any], ros_arguments: Sequence[str]) -> list[str]:
    """Return ROS arguments: parameter file, `parameters`, and the arguments of the user, which override both."""
    arguments = ["--ros-args"]
    if params:
        arguments += ["--params-file", str(params)]
    for name, value in parameters.items():
        if value not in (None, "", []):  # ROS has no type for an empty list
            # ROS parses the value as YAML: unquoted, some file names would become numbers.
            arguments += ["-p", f"{name}:={json.dumps(value)}"]
    return [*arguments, "--", *ros_arguments]
