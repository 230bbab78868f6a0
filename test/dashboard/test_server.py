# SPDX-License-Identifier: Apache-2.0
"""Who may see the page: this machine without a token, others with it, pages of other sites never."""

import asyncio
import csv
import logging
from contextlib import suppress
from types import SimpleNamespace
from typing import Any

import httpx
import pytest
import uvicorn
from starlette.applications import Starlette
from starlette.responses import PlainTextResponse
from starlette.routing import Route

from scara_effmass.cell.status import CellStatus, Diagnostic, ImpactRecord, LoadSample, Validation
from scara_effmass.dashboard.page import contact_rows, csv_of, diagnostic_rows, impact_texts, load_lines, speed_lines
from scara_effmass.dashboard.server import BoundedConnection, Guard, bound_socket, escape_logs, is_local
from scara_effmass.errors import SettingsError
from scara_effmass.safety import unknown_contact
from scara_effmass.values import Impact, Verdict
from test.decisions import decision_on

NUMBERS = dict.fromkeys(("impulse", "onset_sample", "baseline", "noise", "clock_residual"), 0.0)
IMPACT = Impact(1, "", 100.0, 0.02, clipped=False, incomplete=False, rebound=0, source="sim", simulated=True, **NUMBERS)
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


@pytest.mark.parametrize("token", ["", "secret"])
@pytest.mark.parametrize(
    "headers",
    [
        {"host": "[::1"},
        {"host": "localhost:port"},
        {"host": "localhost:123456"},
        {"host": "localhost:99999"},
        {"host": "evil.example@localhost"},
        {"host": "localhost/x"},
        {"host": ""},
        {"origin": "http://[::1"},
        {"origin": "http://localhost:port"},
        {"origin": "localhost"},
        {"origin": "http://localhost http://evil.example"},
    ],
)
def test_malformed_host_and_origin_are_bad_requests(token: str, headers: dict[str, str]) -> None:
    async def answer() -> httpx.Response:
        transport = httpx.ASGITransport(app=Guard(APP, token))
        async with httpx.AsyncClient(transport=transport, base_url="http://localhost") as browser:
            return await browser.get("/", headers=headers)

    assert asyncio.run(answer()).status_code == 400


@pytest.mark.parametrize(("host", "status"), [("localhost:8321", 200), ("[::1]:8321", 200), ("evil.example", 403)])
def test_every_answer_says_what_may_load_and_that_it_fits_no_frame(host: str, status: int) -> None:
    (answer,) = get("", "/", host=host)
    assert answer.status_code == status
    policy = dict(item.strip().split(" ", 1) for item in answer.headers["content-security-policy"].split(";"))
    assert policy["default-src"] == "'self'"
    assert policy["frame-ancestors"] == "'none'"
    assert policy["connect-src"] == f"'self' ws://{host} wss://{host}"
    assert not any(scheme in text.split() for text in policy.values() for scheme in ("*", "http:", "https:"))
    assert (answer.headers["x-frame-options"], answer.headers["x-content-type-options"]) == ("DENY", "nosniff")


async def close(*writers: asyncio.StreamWriter) -> None:
    for writer in writers:
        writer.close()
        with suppress(OSError):
            await writer.wait_closed()


async def open_idle(count: int, idle_s: float) -> tuple[int, bytes, bool]:
    """Open `count` connections that send nothing, and one that sends a request slowly.

    Return how many of the former stay open, the answer to a request meanwhile, and whether the slow one stays open.
    """
    config = uvicorn.Config(Guard(APP, ""), http=BoundedConnection, log_level="critical", lifespan="off")
    server = uvicorn.Server(config)
    with bound_socket("127.0.0.1", 0) as listener:
        port = listener.getsockname()[1]
        serving = asyncio.create_task(server.serve(sockets=[listener]))
        idle = [await asyncio.open_connection("127.0.0.1", port) for _ in range(count)]
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        writer.write(b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n")
        answer = await reader.readline()
        slow, slow_writer = await asyncio.open_connection("127.0.0.1", port)
        ended = asyncio.create_task(slow.read())
        while not ended.done():
            slow_writer.write(b"G")
            await asyncio.wait([ended], timeout=idle_s / 4.0)
        open_ones = sum([not one.at_eof() for one, _ in idle])
        server.should_exit = True
        await serving
        await close(*(each for _, each in idle), writer, slow_writer)
    return open_ones, answer, not ended.done()


def test_idle_and_slow_connections_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("scara_effmass.dashboard.server.IDLE_S", 1.0)
    assert asyncio.run(asyncio.wait_for(open_idle(20, 1.0), 60.0)) == (0, b"HTTP/1.1 200 OK\r\n", False)


def test_number_of_connections_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("scara_effmass.dashboard.server.MAX_CONNECTIONS", 5)

    async def count_open() -> int:
        server = uvicorn.Server(uvicorn.Config(Guard(APP, ""), http=BoundedConnection, log_level="critical"))
        with bound_socket("127.0.0.1", 0) as listener:
            serving = asyncio.create_task(server.serve(sockets=[listener]))
            pairs = [await asyncio.open_connection(*listener.getsockname()) for _ in range(20)]
            reads = [asyncio.create_task(reader.read()) for reader, _ in pairs]
            while sum(read.done() for read in reads) < 15:
                await asyncio.wait([read for read in reads if not read.done()], return_when=asyncio.FIRST_COMPLETED)
            count = sum(not read.done() for read in reads)
            server.should_exit = True
            await serving
            await close(*(writer for _, writer in pairs))
        return count

    assert asyncio.run(asyncio.wait_for(count_open(), 60.0)) == 5


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


@pytest.mark.parametrize("name", ["nicegui", "uvicorn.error"])
def test_no_control_character_of_a_request_reaches_the_terminal(name: str) -> None:
    escape_logs()
    url = "http://localhost/\x1b]0;title\x07\nüber"
    record = logging.LogRecord(name, logging.WARNING, "", 0, "%s not found", (url,), None)
    assert logging.getLogger(name).filter(record)
    assert record.getMessage() == r"http://localhost/\x1b]0;title\x07\nüber not found"


@pytest.mark.parametrize(
    ("left_out", "text"), [("", "none yet"), ("obstacle_mass is not given", "none: obstacle_mass is not given")]
)
def test_impact_without_a_prediction_says_why(left_out: str, text: str) -> None:
    assert impact_texts(ImpactRecord(IMPACT, 0, left_out=left_out)) == ["100.0 N", text, "", ""]


def test_force_that_stays_is_compared_with_its_own_limit() -> None:
    series: Any = None
    peak = ("lower_leg", 60.14, 260.0)
    validation = Validation(1, 99.0, 100.0, -0.01, 0.5, 0.25, False, *peak, True, series, 131.0, 130.0, "lower_leg")  # noqa: FBT003
    *_, text = impact_texts(ImpactRecord(IMPACT, 0, validation=validation))
    assert text.startswith(
        "converted 60.2 N on lower_leg, below its limit of 260.0 N; held 131.0 N on lower_leg, ABOVE"
    )


def test_speed_is_a_gap_while_it_is_not_known() -> None:
    status = CellStatus(0)
    known = unknown_contact("tool", "")._replace(verdict=Verdict.OK, speed=0.2, allowable_speed=0.5, margin=0.3)
    status.take_decision(decision_on(known), 1_000_000_000)
    status.take_decision(decision_on(unknown_contact("tool", "")), 1_100_000_000)
    assert speed_lines(status, 1_100_000_000) == ([[-0.1, 0.5], [0.0, 0.0]], [[-0.1, 0.2], [0.0, None]])


def test_upper_bound_of_the_force_is_rounded_up() -> None:
    status = CellStatus(0)
    contact = unknown_contact("tool", "")._replace(verdict=Verdict.OK, force_bound=9.2)
    status.take_publisher(400_000_000, exists=True)
    status.take_decision(decision_on(contact), 1)
    headings, (row,), _ = contact_rows(status)
    assert dict(zip(headings, row, strict=True))["upper bound of force"] == "10 N"


def test_a_mass_at_its_cap_is_a_least_one() -> None:
    status = CellStatus(0)
    contact = unknown_contact("tool", "")._replace(verdict=Verdict.OK, effective_mass=1000.0, mass_capped=True)
    status.take_publisher(400_000_000, exists=True)
    status.take_decision(decision_on(contact), 1)
    headings, (row,), _ = contact_rows(status)
    assert dict(zip(headings, row, strict=True))["deciding mass"].endswith("at least 1000.00 kg")


def test_diagnostics_of_a_contact_point_whose_name_has_a_slash_name_their_node() -> None:
    status = CellStatus(0)
    status.take_diagnostic(Diagnostic("/cell/monitor: contact left/tool", 0, "OK", {}, 1))
    assert list(diagnostic_rows(status, 2)) == [["monitor contact left/tool", "OK", "OK"]]


def test_load_that_is_not_observable_is_a_gap() -> None:
    status, now_ns = CellStatus(0), 100_000_000_000
    sample = LoadSample(now_ns - 2_000_000_000, 0.5, 0.4, 0.6, 0.25, is_observable=True, text="")
    for one in (sample._replace(at_ns=1), sample, sample._replace(at_ns=now_ns, is_observable=False)):
        status.loads.append(one)
    load, lower, upper, stated = load_lines(status, now_ns)
    assert load == [[-2.0, 0.5], [0.0, None]]
    assert [line[0][1] for line in (lower, upper, stated)] == [0.4, 0.6, 0.25]
