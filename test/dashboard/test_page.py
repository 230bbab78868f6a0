# SPDX-License-Identifier: Apache-2.0
"""The page in a real browser without a network: it shows what holds, and never an old OK."""

import http.client
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, closing, contextmanager
from functools import partial
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Locator, Page, expect, sync_playwright

from test.forked import Forked
from test.nodes.conftest import NodeHarness, joint_state

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
WAIT_MS = 90_000.0
TIMEOUT_S = 1.0
"""Of the monitor; its deadline is twice that."""
MONITOR = ("--ros-args", "-p", f"timeout:={TIMEOUT_S}", "-p", "release_time:=0.0", "-p", "contact_points:=[whole_arm]")
TOKEN = "secret"  # noqa: S105
CARDS = (
    *("Robot", "Speed and allowable speed, last 60 s", "Contact points", "Last impacts"),
    *("Predicted and measured peak force", "Load by the torques, last 60 s", "Diagnostics", "Episodes"),
)
FETCHED_HULLS = """count => new Set(
  performance.getEntriesByType("resource").map(entry => new URL(entry.name).pathname)
    .filter(path => path.startsWith("/hulls/"))
).size === count"""
LOW_CONTRAST = """() => {
  const rgba = text => [...text.matchAll(/[\\d.]+/g)].map(Number);
  const channel = c => (c /= 255) <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4;
  const light = ([r, g, b]) => 0.2126 * channel(r) + 0.7152 * channel(g) + 0.0722 * channel(b);
  const grounds = e => {
    for (; e; e = e.parentElement) {
      const style = getComputedStyle(e);
      if (style.backgroundImage !== "none") return style.backgroundImage.match(/rgb\\([^)]*\\)/g).map(rgba);
      const color = rgba(style.backgroundColor);
      if (color.length === 3 || color[3] > 0) return [color];
    }
    return [[255, 255, 255]];
  };
  const low = [];
  for (const e of document.querySelectorAll("h1, h2, p, a, b, th, td, label, div, span, text")) {
    const text = [...e.childNodes].filter(n => n.nodeType === 3).map(n => n.textContent.trim()).join("");
    if (!text || !e.getClientRects().length) continue;
    const style = getComputedStyle(e), svg = e.tagName === "text";
    const ink = light(rgba(svg ? style.fill : style.color));
    for (const ground of grounds(e).map(light)) {
      const ratio = (Math.max(ink, ground) + 0.05) / (Math.min(ink, ground) + 0.05);
      if (ratio < 4.5) low.push(`${ratio.toFixed(2)} ${text}`);
    }
  }
  return low;
}"""

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on the path: apt-get install chromium")


@pytest.fixture
def monitor(reserve_domain: Callable[[], AbstractContextManager[int]], tmp_path: Path) -> Iterator[NodeHarness]:
    """Run a monitor that gets a joint state every 0.1 s."""
    with reserve_domain() as domain, pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        patch.setenv("ROS_DOMAIN_ID", str(domain))
        with closing(NodeHarness(domain, tmp_path)) as harness:
            harness.start(*MONITOR)
            harness.process_may_end = True
            ended = threading.Event()

            def send() -> None:
                while not ended.wait(0.1):
                    harness.send(joint_state())

            thread = threading.Thread(target=send)
            thread.start()
            yield harness
            ended.set()
            thread.join()


@contextmanager
def dashboard(port: str = "0") -> Iterator[tuple[subprocess.Popen[str], str]]:
    """Run the dashboard; give its process and address."""
    words = [
        sys.executable,
        "-m",
        "scara_effmass",
        "dashboard",
        "--port",
        port,
        "--token",
        TOKEN,
        "--contact-point",
        "whole_arm",
    ]
    with Forked(words, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            yield process, process.stdout.readline().split()[1]
        finally:
            process.kill()


@pytest.fixture
def browser() -> Iterator[Browser]:
    """Start a browser that reaches this machine only."""
    closed = ("--proxy-server=127.0.0.1:9", "--proxy-bypass-list=127.0.0.1", "--enable-unsafe-swiftshader")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox", *closed])
        yield browser
        browser.close()


def expect_verdict(page: Page, verdict: str, timeout_ms: float = WAIT_MS) -> None:
    """Wait until the only word that can be seen is `verdict`, in its own colours."""
    pattern = re.compile(rf"^\s*{verdict}(?![A-Z])")
    expect(page.locator(".verdict:visible")).to_have_text(pattern, timeout=timeout_ms, use_inner_text=True)
    expect(page.locator(f".verdict.{verdict}:visible")).to_have_count(1)


def websocket_status(port: int) -> int:
    """Return the HTTP status of a websocket without the token."""
    connection = http.client.HTTPConnection("127.0.0.1", port)
    words = {
        "Upgrade": "websocket",
        "Connection": "Upgrade",
        "Sec-WebSocket-Version": "13",
        "Sec-WebSocket-Key": 22 * "A" + "==",
    }
    connection.request("GET", "/_nicegui_ws/socket.io/?EIO=4&transport=websocket", headers=words)
    with closing(connection):
        return connection.getresponse().status


def expect_narrow_layout(page: Page) -> Locator:
    """Narrow the page and print it: no text is squeezed or cut, and a print has a date; return the row of a contact."""

    def size(place: Locator, name: str) -> int:  # 0 where an update has just replaced it
        return int(next(filter(None, iter(partial(place.evaluate, f"place => place.{name}"), None))))

    page.set_viewport_size({"width": 768, "height": 1024})
    page.wait_for_function("document.documentElement.scrollWidth == 768")  # the plots follow their observers
    assert size(page.get_by_role("region", name="Episodes").get_by_role("cell").last, "clientWidth") > 100
    page.emulate_media(media="print")
    numbers = page.get_by_role("region", name="Contact points").locator(".numbers")
    assert size(numbers, "scrollWidth") <= size(numbers, "clientWidth")
    assert re.fullmatch(r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d", page.get_by_role("timer").inner_text())
    page.emulate_media(media="screen")
    page.set_viewport_size({"width": 390, "height": 844})
    page.wait_for_function("document.documentElement.scrollWidth == 390")
    assert size(page.get_by_role("region", name="Episodes").get_by_role("cell").last, "clientWidth") > 100
    contact = page.get_by_role("region", name="Contact points").get_by_role("row").nth(1)
    assert size(contact, "offsetHeight") < 40
    return contact


def test_the_page_shows_what_holds_and_never_an_old_ok(monitor: NodeHarness, browser: Browser) -> None:
    addresses: list[str] = []
    page = browser.new_page(viewport={"width": 1440, "height": 1000})
    page.on("request", lambda request: addresses.append(request.url))
    page.on("websocket", lambda socket: addresses.append(socket.url))
    with dashboard() as (process, address):
        port = address.split(":")[2].split("/")[0]
        for path in ("", "?token=wrong", "episodes.csv"):
            assert page.request.get(f"http://127.0.0.1:{port}/{path}").status == 401
        assert websocket_status(int(port)) == 403
        page.goto(address)

        expect_verdict(page, "OK")
        for card in CARDS:
            expect(page.get_by_role("region", name=card, exact=True)).to_be_visible()
        expect(page.get_by_role("main")).to_have_count(1)
        expect(page.get_by_text("not a certified safety function")).to_be_visible()
        expect(page.get_by_role("columnheader", name="effective mass, full")).to_be_visible()
        expect(page.get_by_role("rowheader", name="monitor model")).to_be_visible(timeout=WAIT_MS)
        load = page.get_by_role("region", name="Load by the torques, last 60 s")
        expect(load).to_contain_text("unknown: it needs joint states with finite effort of all joints", timeout=WAIT_MS)
        assert page.locator("canvas").bounding_box()
        page.wait_for_function(FETCHED_HULLS, arg=4, timeout=WAIT_MS)
        hull, missing = (page.request.get(f"http://127.0.0.1:{port}/hulls/{number}.stl") for number in (0, 4))
        assert (hull.status, missing.status) == (200, 404)
        assert len(hull.body()) == 84 + 50 * 12  # a box has twelve triangles
        assert page.evaluate(LOW_CONTRAST) == []

        for speed, verdict in ((9.0, "VIOLATION"), (0.0, "OK")):
            assert monitor.set_parameters(person_speed=speed) == ""
            expect_verdict(page, verdict)
            assert page.evaluate(LOW_CONTRAST) == []

        assert monitor.process is not None
        os.kill(monitor.process.pid, signal.SIGKILL)
        expect_verdict(page, "UNKNOWN", 1e3 * (2.0 * TIMEOUT_S + 3.0))
        expect(page.locator(".now")).to_contain_text("0 m/s")
        assert page.evaluate(LOW_CONTRAST) == []
        monitor.process.communicate()
        monitor.start(*MONITOR)
        expect_verdict(page, "OK")
        expect(page.get_by_role("region", name="Episodes")).to_contain_text("the monitor is silent")
        table = page.request.get(f"http://127.0.0.1:{port}/episodes.csv").text()
        assert table.startswith("verdict,start,end,duration_s,contact_point,cause,simulated\r\nUNKNOWN,")
        assert "\r\nVIOLATION," in table

        contact = expect_narrow_layout(page)
        process.kill()
        expect_verdict(page, "UNKNOWN", 5e3)
        expect(page.get_by_text("no connection to the dashboard server")).to_be_visible()
        expect(contact).to_be_hidden()
        expect(page.get_by_role("timer")).to_be_hidden()
    with dashboard(port):
        expect_verdict(page, "OK")
    assert addresses
    assert not [
        url for url in addresses if not url.startswith((f"http://127.0.0.1:{port}/", f"ws://127.0.0.1:{port}/"))
    ]
