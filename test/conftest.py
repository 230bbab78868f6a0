# SPDX-License-Identifier: Apache-2.0
"""Settings and fixtures of all tests: reproducible Hypothesis runs, ROS domains, the `live` marker."""

import gc
import os
import signal
import socket
import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from itertools import count
from typing import Any

import pytest
from hypothesis import HealthCheck, Phase, settings

from scara_effmass.cli.processes import DOMAINS, domain_is_free
from scara_effmass.kernel import compiled

# No deadline: the machine may be busy. The same examples in every run: a failure must be reproducible.
settings.register_profile("reproducible", deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("mutants", settings.get_profile("reproducible"), phases=[Phase.explicit, Phase.generate])
settings.load_profile("reproducible")

# A shell starts background jobs with SIGINT ignored, and child processes would inherit that.
signal.signal(signal.SIGINT, signal.default_int_handler)

LIVE_FIXTURES = {"own_domain", "reserve_domain"}
"""A test that uses one of these, directly or through other fixtures, talks to DDS."""

_domain_numbers = count(os.getpid() * 13)
_is_live = True


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark every test that uses DDS as `live`, and let each worker process begin with live ones.

    They mostly wait, and the short other ones at the end are shared evenly.
    """
    live: list[pytest.Item] = []
    other: list[pytest.Item] = []
    for item in items:
        if LIVE_FIXTURES & set(getattr(item, "fixturenames", ())):
            item.add_marker(pytest.mark.live)
        (live if item.get_closest_marker("live") else other).append(item)
    workers = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
    items.clear()
    for number in range(workers):  # pytest-xdist gives each an equal part of the list
        for part in (live, other):
            items += part[len(part) * number // workers : len(part) * (number + 1) // workers]


def pytest_collection_finish(session: pytest.Session) -> None:
    """Compile a kernel that has changed; let the garbage collector skip the imports and the collected tests."""
    if not session.config.option.collectonly:
        compiled.why_not()
    gc.freeze()


def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """Return the default number of worker processes: one per core, and more for live tests, which mostly wait."""
    cores = len(os.sched_getaffinity(0))
    return cores if config.option.markexpr == "not live" else 2 * cores


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """Note whether the running test may start programs of the suite."""
    global _is_live  # noqa: PLW0603 - an audit hook is global and cannot be removed
    _is_live = item.get_closest_marker("live") is not None
    try:
        return (yield)
    finally:
        _is_live = True


def _refuse_process(event: str, arguments: tuple[Any, ...]) -> None:
    """Refuse to start Python or a program of this environment from a test that is not marked `live`."""
    if event == "subprocess.Popen" and not _is_live and os.fspath(arguments[0]).startswith(sys.prefix):
        raise RuntimeError("a test that starts a process must be marked: @pytest.mark.live")


sys.addaudithook(_refuse_process)


@contextmanager
def _reserved_domain() -> Iterator[int]:
    for _ in range(10 * DOMAINS):
        domain = 1 + next(_domain_numbers) % DOMAINS
        # DDS uses UDP ports only, so a TCP port can lock the domain against the other test processes of this machine.
        with socket.socket(type=socket.SOCK_STREAM) as lock:
            try:
                lock.bind(("127.0.0.1", 7400 + 250 * domain))
            except OSError:
                continue
            if domain_is_free(domain):
                yield domain
                return
    raise RuntimeError("no ROS domain is free on this machine")


@pytest.fixture(scope="session")
def reserve_domain() -> Callable[[], AbstractContextManager[int]]:
    """Return a context manager that reserves an unused ROS domain against all test processes of this machine."""
    return _reserved_domain


@pytest.fixture
def unrendered(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw the figures of reports, but write empty files: rendering takes most of the time of a command."""
    monkeypatch.setattr("scara_effmass.analysis.report.FigureCanvasAgg.print_png", lambda *_: None)
    monkeypatch.setattr("scara_effmass.analysis.report.FigureCanvasSVG.print_svg", lambda *_, **__: None)


@pytest.fixture
def own_domain(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """Put this process and its children into a reserved ROS domain, on this machine only."""
    with _reserved_domain() as domain:
        monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
        yield domain
