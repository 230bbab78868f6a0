# SPDX-License-Identifier: Apache-2.0
"""HTTP server of the dashboard: page, token, polling of the cell."""

import asyncio
import hmac
import ipaddress
import logging
import re
import socket
from collections.abc import Callable
from typing import Any
from urllib.parse import urlsplit

import uvicorn
from fastapi import FastAPI
from nicegui import app as page_app
from nicegui import ui
from starlette.requests import HTTPConnection
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol

from scara_effmass.dashboard.page import Page, csv_of
from scara_effmass.dashboard.scene import stl_of
from scara_effmass.errors import SettingsError
from scara_effmass.nodes.cell_client import CellClient
from scara_effmass.reference import RobotDynamics
from scara_effmass.settings import MonitorSettings

_POLL_S = 0.05
_LOCAL_NAMES = {"localhost", "127.0.0.1", "::1"}
_HOST = re.compile(r"(?:[A-Za-z0-9._-]+|\[[0-9A-Fa-f:.]+\])(?::\d{1,5})?")
_ORIGIN = re.compile(rf"null|[A-Za-z][A-Za-z0-9+.-]*://(?:{_HOST.pattern})?")
_POLICY = (
    "default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval' blob:; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data: blob:; font-src 'self' data:; connect-src 'self' ws://{host} wss://{host}; "
    "worker-src 'self' blob:; object-src 'none'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
)
"""Vue compiles its templates in the page, which needs inline scripts and eval; nothing comes from elsewhere."""
_HEADERS = {"x-frame-options": "DENY", "x-content-type-options": "nosniff", "referrer-policy": "no-referrer"}
IDLE_S = 10.0
"""Time for which a connection may be open without a complete request."""
MAX_CONNECTIONS = 100


def _is_valid(address: str, form: re.Pattern[str]) -> bool:
    try:
        urlsplit(f"//{address.rpartition('//')[2]}").port  # noqa: B018 - raises ValueError above 65535
    except ValueError:
        return False
    return form.fullmatch(address) is not None


class Guard:
    """ASGI application that passes on requests and websockets of this page; with a token, only those that have it."""

    def __init__(self, app: ASGIApp, token: str) -> None:
        """Guard `app`; without a `token`, requests must name this machine, as pages of other sites cannot."""
        self.app = app
        self._token = token

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one connection."""
        if scope["type"] == "lifespan":
            await self.app(scope, receive, send)
            return
        request = HTTPConnection(scope)
        malformed = self._malformed(request)
        answer = malformed or self._refusal(request)

        async def send_guarded(message: Message) -> None:
            if message["type"] in {"http.response.start", "websocket.http.response.start"}:
                message = {**message, "headers": [*message.get("headers", ()), *_headers(request)]}
            await send(message)

        if answer is None:
            await self.app(scope, receive, send_guarded)
        elif scope["type"] == "websocket" and (
            malformed is None or "websocket.http.response" not in scope.get("extensions", {})
        ):
            await send({"type": "websocket.close", "code": 1008})
        else:
            await answer(scope, receive, send_guarded)

    def _malformed(self, request: HTTPConnection) -> Response | None:
        for name, form, least in (("host", _HOST, 1), ("origin", _ORIGIN, 0)):
            values = request.headers.getlist(name)
            if not least <= len(values) <= 1 or not all(_is_valid(value, form) for value in values):
                return PlainTextResponse(f"the header {name} must be stated once and valid", 400)
        return None

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


def _headers(request: HTTPConnection) -> list[tuple[bytes, bytes]]:
    """Return the headers of each answer: what the page may load, and that no other page shows it in a frame."""
    host = request.headers.get("host", "")
    policy = _POLICY.format(host=host if _HOST.fullmatch(host) else "localhost")
    headers = {**_HEADERS, "content-security-policy": policy}
    return [(name.encode(), text.encode()) for name, text in headers.items()]


class BoundedConnection(H11Protocol):
    """HTTP connection that ends without a complete request within IDLE_S; at most MAX_CONNECTIONS are open."""

    _deadline: asyncio.TimerHandle | None = None

    def connection_made(self, transport: Any) -> None:  # noqa: ANN401 - as in the base class
        """Await a request, or end where too many connections are open."""
        super().connection_made(transport)
        if len(self.connections) > MAX_CONNECTIONS:
            transport.abort()
        self._await_request()

    def data_received(self, data: bytes) -> None:
        """Take a part of a request."""
        super().data_received(data)
        self._await_request()

    def handle_websocket_upgrade(self, event: Any) -> None:  # noqa: ANN401 - as in the base class
        """Hand over to the protocol for websockets, which pings."""
        self._end_wait()
        super().handle_websocket_upgrade(event)

    def connection_lost(self, exc: Exception | None) -> None:
        """End."""
        self._end_wait()
        super().connection_lost(exc)

    def _await_request(self) -> None:
        """Set the deadline while no request is being answered; more data does not extend it."""
        cycle: Any = self.cycle  # None before the first request
        if self.transport.get_protocol() is not self or (cycle is not None and not cycle.response_complete):
            self._end_wait()
        elif self._deadline is None:
            self._deadline = self.loop.call_later(IDLE_S, self.transport.abort)

    def _end_wait(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None


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


def _escape(record: logging.LogRecord) -> bool:
    text = record.getMessage().rstrip()
    record.msg = "".join(character if character.isprintable() else ascii(character)[1:-1] for character in text)
    record.args = None
    return True


def escape_logs() -> None:
    """Escape the log lines of the server, which can quote a request: a terminal obeys control characters."""
    for name in ("nicegui", "uvicorn.error"):
        logging.getLogger(name).addFilter(_escape)


def serve(
    client: CellClient,
    dynamics: RobotDynamics,
    settings: MonitorSettings,
    listener: socket.socket,
    token: str,
    on_start: Callable[[], None],
) -> None:
    """Serve the page of the cell until a signal ends the process; call `on_start` once it answers."""
    escape_logs()
    page_app.timer(_POLL_S, client.poll)
    page_app.on_startup(on_start)
    ui.page("/", title="scara_effmass", favicon="🦾")(lambda: Page(client, dynamics, settings))

    @page_app.get("/episodes.csv")
    def episodes() -> Response:
        name = {"Content-Disposition": 'attachment; filename="episodes.csv"'}
        return Response(csv_of(client), media_type="text/csv", headers=name)

    hulls = stl_of(dynamics.robot)

    @page_app.get("/hulls/{number}.stl")
    def hull(number: int) -> Response:
        found = hulls[number : number + 1] if number >= 0 else []
        return Response(found[0], media_type="model/stl") if found else Response(status_code=404)

    app = FastAPI(openapi_url=None)
    ui.run_with(app, show_welcome_message=False, tailwind=False, binding_refresh_interval=None)
    config = uvicorn.Config(Guard(app, token), http=BoundedConnection, log_level="warning", timeout_graceful_shutdown=1)
    uvicorn.Server(config).run(sockets=[listener])
