# SPDX-License-Identifier: Apache-2.0
"""Who may see the page: this machine without a token, others with it, pages of other sites never."""

import asyncio
import csv
from types import SimpleNamespace
from typing import Any

import httpx
import pytest
from starlette.applications import Starlette
from starlette.responses import PlainTextResponse
from starlette.routing import Route

from scara_effmass.cell.status import CellStatus
from scara_effmass.dashboard.page import csv_of
from scara_effmass.dashboard.server import Guard, bound_socket, is_local
from scara_effmass.errors import SettingsError
from scara_effmass.safety import unknown_contact
from scara_effmass.values import Verdict
from test.decisions import decision_on

APP = Starlette(routes=[Route("/", lambda _: PlainTextResponse("page"))])


def get(token: str, *paths: str, host: str = "127.0.0.1:8321", origin: str = "") -> list[httpx.Response]:
    """Return the answers to one browser that gets `paths` one after the other."""

    async def answers() -> list[httpx.Response]:
        transport = httpx.ASGITransport(app=Guard(APP, token))
        headers = {"origin": origin} if origin else {}
        async with httpx.AsyncClient(transport=transport, base_url=f"http://{host}", follow_redirects=True) as browser:
            return [await browser.get(path, headers=headers) for path in paths]

    return asyncio.run(answers())


@pytest.mark.parametrize(("host", "status"), [("127.0.0.1:8321", 200), ("localhost", 200), ("evil.example", 403)])
def test_without_a_token_only_the_names_of_this_machine_are_answered(host: str, status: int) -> None:
    assert get("", "/", host=host)[0].status_code == status


@pytest.mark.parametrize("token", ["", "secret"])
def test_requests_of_pages_of_other_sites_are_refused(token: str) -> None:
    (answer,) = get(token, "/", origin="http://evil.example")
    assert (answer.status_code, answer.text) == (403, "requests of other sites are refused")


def test_the_token_of_the_address_becomes_a_cookie() -> None:
    wrong = ("/", "/?token=", "/?token=wrong", "/?token=secre%C3%BC")
    *refused, accepted, later = get("secret", *wrong, "/?token=secret", "/")
    assert [answer.status_code for answer in refused] == [401] * 4
    assert (accepted.text, str(accepted.url), later.text) == ("page", "http://127.0.0.1:8321/", "page")
    assert "HttpOnly; Path=/; SameSite=lax" in accepted.history[0].headers["set-cookie"]


LOCAL = ("127.0.0.1", "::1", "localhost")


@pytest.mark.parametrize("host", [*LOCAL, "10.0.0.1", "::", "cell"])
def test_only_loopback_needs_no_token(host: str) -> None:
    assert is_local(host) is (host in LOCAL)


def test_a_port_in_use_is_refused() -> None:
    with bound_socket("127.0.0.1", 0) as listener:
        port = listener.getsockname()[1]
        with pytest.raises(SettingsError, match=f"^dashboard: 127.0.0.1:{port}: must be a free address"):
            bound_socket("127.0.0.1", port)


def test_spreadsheets_evaluate_no_text_of_a_message() -> None:
    status = CellStatus(0)
    status.episodes.clear()
    status.take_decision(decision_on(unknown_contact("tool", "")._replace(verdict=Verdict.OK)), 1)
    status.take_decision(decision_on(unknown_contact("=A1", "+A2")), 2)
    client: Any = SimpleNamespace(status=status, wall_ns=lambda at_ns: at_ns)
    _, row = csv.reader(csv_of(client).splitlines())
    assert (row[0], row[4], row[5]) == ("UNKNOWN", "'=A1", "'+A2")
