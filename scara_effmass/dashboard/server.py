# SPDX-License-Identifier: Apache-2.0
"""HTTP server of the dashboard: page, token, polling of the cell."""

import hmac
import ipaddress
import socket
from collections.abc import Callable
from urllib.parse import urlsplit

import uvicorn
from fastapi import FastAPI
from nicegui import app as page_app
from nicegui import ui
from starlette.requests import HTTPConnection
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Receive, Scope, Send

from scara_effmass.dashboard.page import Page, csv_of
from scara_effmass.errors import SettingsError
from scara_effmass.nodes.cell_client import CellClient
from scara_effmass.reference import RobotDynamics
from scara_effmass.settings import MonitorSettings

_POLL_S = 0.05
_LOCAL_NAMES = {"localhost", "127.0.0.1", "::1"}


class Guard:
    """ASGI application that passes on requests and websockets of this page; with a token, only those that have it."""

    def __init__(self, app: ASGIApp, token: str) -> None:
        """Guard `app`; without a `token`, requests must name this machine, as pages of other sites cannot."""
        self.app = app
        self._token = token

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one connection."""
        answer = None if scope["type"] == "lifespan" else self._refusal(HTTPConnection(scope))
        if answer is None:
            await self.app(scope, receive, send)
        elif scope["type"] == "websocket":
            await send({"type": "websocket.close", "code": 1008})
        else:
            await answer(scope, receive, send)

    def _refusal(self, request: HTTPConnection) -> Response | None:
        url = urlsplit(f"//{request.headers.get('host', '')}")
        cookie = f"dashboard_{url.port}"
        if urlsplit(request.headers.get("origin", f"//{url.netloc}")).netloc != url.netloc:
            return PlainTextResponse("requests of other sites are refused", 403)
        if not self._token:
            return None if url.hostname in _LOCAL_NAMES else PlainTextResponse("must be called as localhost", 403)
        if self._fits(request.query_params.get("token", "")):
            answer = RedirectResponse("/", 303)
            answer.set_cookie(cookie, self._token, httponly=True, samesite="lax")
            return answer
        if self._fits(request.cookies.get(cookie, "")):
            return None
        return PlainTextResponse("add ?token=TOKEN to the address, as `scara-effmass dashboard` prints it", 401)

    def _fits(self, token: str) -> bool:
        return hmac.compare_digest(token.encode(), self._token.encode())


def is_local(host: str) -> bool:
    """Return whether only this machine can reach `host`."""
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def bound_socket(host: str, port: int) -> socket.socket:
    """Return a socket that listens there; port 0 takes a free one. Raises SettingsError."""
    try:
        return socket.create_server((host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET)
    except OSError as error:
        raise SettingsError(f"dashboard: {host}:{port}: must be a free address of this machine: {error}") from None


def serve(
    client: CellClient,
    dynamics: RobotDynamics,
    settings: MonitorSettings,
    listener: socket.socket,
    token: str,
    on_start: Callable[[], None],
) -> None:
    """Serve the page of the cell until a signal ends the process; call `on_start` once it answers."""
    page_app.timer(_POLL_S, client.poll)
    page_app.on_startup(on_start)
    ui.page("/", title="scara_effmass", favicon="🦾")(lambda: Page(client, dynamics, settings))

    @page_app.get("/episodes.csv")
    def episodes() -> Response:
        name = {"Content-Disposition": 'attachment; filename="episodes.csv"'}
        return Response(csv_of(client), media_type="text/csv", headers=name)

    app = FastAPI(openapi_url=None)
    ui.run_with(app, show_welcome_message=False, tailwind=False, binding_refresh_interval=None)
    config = uvicorn.Config(Guard(app, token), log_level="warning", timeout_graceful_shutdown=1)
    uvicorn.Server(config).run(sockets=[listener])
