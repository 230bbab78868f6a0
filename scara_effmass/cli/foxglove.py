# SPDX-License-Identifier: Apache-2.0
"""`scara-effmass foxglove`."""

import argparse
from functools import partial

from scara_effmass.cli.console import printer


def run(args: argparse.Namespace) -> int:
    """Serve live topics until a signal ends it."""
    from scara_effmass.nodes.foxglove_server import serve  # noqa: PLC0415 - rclpy, and an optional library

    show = partial(printer().print, soft_wrap=True)
    serve(
        args.topics,
        args.host,
        args.port,
        args.ros_arguments,
        ready=lambda port: show(f"serving on ws://{args.host}:{port}; Ctrl-C ends it"),
        warn=show,
    )
    return 0
