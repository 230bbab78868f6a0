"""What holds for all tests."""

from __future__ import annotations

import os
import signal
import socket
from contextlib import contextmanager
from itertools import count
from typing import TYPE_CHECKING

import pytest
from hypothesis import HealthCheck, settings

from scara_effmass.cli.processes import DOMAINS, domain_is_free

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from contextlib import AbstractContextManager

# A busy machine is no failure, and a failure must come back when it is looked into.
settings.register_profile(
    "same_every_time", deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("same_every_time")

# A shell starts what runs in its background with SIGINT ignored, and so would all that the tests start and interrupt.
signal.signal(signal.SIGINT, signal.default_int_handler)

_tried = count(os.getpid() * 13)


@contextmanager
def _reserved_domain() -> Iterator[int]:
    for _ in range(10 * DOMAINS):
        domain = 1 + next(_tried) % DOMAINS
        # DDS takes UDP ports only; the TCP port is the flag by which the test runs of one machine keep apart.
        with socket.socket(type=socket.SOCK_STREAM) as flag:
            try:
                flag.bind(("127.0.0.1", 7400 + 250 * domain))
            except OSError:
                continue
            if domain_is_free(domain):
                yield domain
                return
    raise RuntimeError("no ROS domain is free on this machine")


@pytest.fixture(scope="session")
def reserve_domain() -> Callable[[], AbstractContextManager[int]]:
    """Give a ROS domain that nobody on this machine is in, and that no other test takes during a `with`."""
    return _reserved_domain


@pytest.fixture
def own_domain(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """Put this process, and those it starts, into a ROS domain of this test, on this machine only."""
    with _reserved_domain() as domain:
        monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
        yield domain
