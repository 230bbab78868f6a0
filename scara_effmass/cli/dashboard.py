# SPDX-License-Identifier: Apache-2.0
"""`scara-effmass dashboard`."""

import argparse
import os
import secrets
import socket
import threading
import webbrowser

from scara_effmass.cli.console import print_lines
from scara_effmass.cli.settings import load_dynamics, monitor_settings

_NICENESS = 10
"""The nodes on this machine have priority over the dashboard."""


def has_display() -> bool:
    """Return whether a browser can open a window here."""
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def run(args: argparse.Namespace) -> int:
    """Serve the page until a signal ends it; return 0. Raises EffmassError."""
    from scara_effmass.dashboard.server import bound_socket, is_local, serve  # noqa: PLC0415 - an extra
    from scara_effmass.nodes.cell_client import CellClient  # noqa: PLC0415 - rclpy

    settings = monitor_settings(args)
    dynamics = load_dynamics(settings)
    token = args.token or ("" if is_local(args.host) else secrets.token_urlsafe(16))
    listener = bound_socket(args.host, args.port)
    is_any = args.host in {"0.0.0.0", "::"}  # noqa: S104 - only compared
    host = socket.gethostname() if is_any else f"[{args.host}]" if ":" in args.host else args.host
    address = f"http://{host}:{listener.getsockname()[1]}/{f'?token={token}' if token else ''}"

    def on_start() -> None:
        print_lines([("dashboard", address)])
        if args.open and has_display():
            threading.Thread(target=webbrowser.open, args=(address,), daemon=True).start()  # some browsers block

    os.nice(_NICENESS)
    with listener, CellClient("dashboard", args.ros_arguments) as client:
        serve(client, dynamics, settings, listener, token, on_start)
    return 0
