# SPDX-License-Identifier: Apache-2.0
"""The SROS 2 policies are what the nodes use, and nothing more; a node that cannot be secured does not run.

The wheels of Fast DDS are built without DDS Security, so no test here can see a foreign publisher refused.
"""

import os
import re
import runpy
import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress
from fnmatch import fnmatch
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import pytest
from hypothesis import given
from hypothesis import strategies as st

from scara_effmass.analysis.report import environment
from test.forked import Forked
from test.nodes.conftest import MONITOR_NODE

ROOT = Path(__file__).parents[2]
POLICY = ET.parse(ROOT / "config/security_policy.xml").getroot()
REFERENCE: dict[str, Any] = runpy.run_path(str(ROOT / "scripts/docs_reference.py"))
KINDS = {kind.__name__.removesuffix("Node").lower(): kind for kind in REFERENCE["_node_kinds"]()}
NODES = {"monitor": "monitor", "daq": "daq", "validator": "validator", "speedscaling": "speed_scaling"}
NODES["visualization"] = "visualization"
FURTHER_CHANNELS = {("publish", f"{topic}/*") for topic in ("force", "impact", "wrench")}
ALWAYS = {("publish", "/rosout"), ("publish", "~transition_event")}
"""Endpoints of ROS that the node object does not list."""


def profile(node: str) -> ET.Element:
    found = POLICY.find(f"contexts/context[@path='/scara_effmass/{node}']/profiles/profile[@node='{node}']")
    assert found is not None
    return found


def granted(node: str) -> set[tuple[str, str]]:
    return {(right, str(name.text)) for group in profile(node) for right in group.attrib for name in group}


def used(node: str, kind: type, settings: Sequence[str]) -> set[tuple[str, str]]:
    """Return the endpoints that the node has with any of `settings`, named as in a policy."""
    endpoints = set(ALWAYS)
    for setting in settings:
        with REFERENCE["_node"](kind, setting) as instance:
            instance.configure()
            names = [("publish", p.topic_name) for p in instance.publishers]
            names += [("subscribe", s.topic_name) for s in instance.subscriptions]
            names += [("reply", instance.resolve_service_name(s.srv_name)) for s in instance.services]
            names += [("request", c.srv_name) for c in instance.clients]
        for right, name in names:
            own = name.replace(f"/cell/{node}/", "~")
            endpoints.add((right, own.removeprefix("/cell/")))
    return endpoints


def test_policy_has_the_elements_and_attributes_of_sros2() -> None:
    assert (POLICY.tag, POLICY.attrib, [child.tag for child in POLICY]) == (
        "policy",
        {"version": "0.2.0"},
        ["contexts"],
    )
    for context in POLICY[0]:
        (profiles,) = context
        assert (context.tag, list(context.attrib), profiles.tag) == ("context", ["path"], "profiles")
        assert [(item.tag, sorted(item.attrib)) for item in profiles] == [("profile", ["node", "ns"])]
        for group in profiles[0]:
            item, rights = {
                "topics": ("topic", {"publish", "subscribe"}),
                "services": ("service", {"reply", "request"}),
            }[group.tag]
            assert rights >= set(group.attrib)
            assert set(group.attrib.values()) == {"ALLOW"}
            assert len(group)
            assert {child.tag for child in group} == {item}


@pytest.mark.live
@pytest.mark.parametrize(("kind", "node"), NODES.items())
def test_policy_grants_what_a_node_uses_and_nothing_more(kind: str, node: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "OFF")
    needed = used(node, KINDS[kind], REFERENCE["VARIANTS"].get(node, ("",)))
    allowed = granted(node)
    assert needed - allowed == set()
    assert allowed - needed == (FURTHER_CHANNELS if node == "daq" else set())
    assert {right for right, name in allowed if fnmatch(name, "*[*]*")} <= {"publish"}


@pytest.mark.live
@pytest.mark.parametrize("has_keys", [False, True])
def test_a_node_that_cannot_be_secured_ends_with_one_line(tmp_path: Path, *, has_keys: bool) -> None:
    enclave = tmp_path / "enclaves/scara_effmass/monitor"
    if has_keys:  # that no authority has signed
        enclave.mkdir(parents=True)
        for name in ("identity_ca.cert", "cert", "key", "permissions_ca.cert"):
            (enclave / f"{name}.pem").write_text("no key", encoding="ascii")
        for name in ("governance", "permissions"):
            (enclave / f"{name}.p7s").write_text("no signature", encoding="ascii")
    environment = {"ROS_SECURITY_ENABLE": "true", "ROS_SECURITY_STRATEGY": "Enforce"}
    environment |= {"ROS_SECURITY_KEYSTORE": str(tmp_path), "ROS_LOG_DIR": str(tmp_path)}
    process = subprocess.run(
        [MONITOR_NODE, "--ros-args", "--enclave", "/scara_effmass/monitor"],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert process.returncode == 2
    assert "Traceback" not in process.stderr
    refusal = (
        "monitor: error creating node: " if has_keys else "ROS arguments: failed to initialize rcl: SECURITY ERROR: "
    )
    assert [line.startswith(refusal) for line in process.stderr.splitlines()].count(True) == 1


def listening(pid: int) -> set[str]:
    """Return the addresses (hexadecimal IPv4, as in /proc) on which a process listens for TCP."""
    sockets = set()
    for link in Path(f"/proc/{pid}/fd").iterdir():
        with suppress(FileNotFoundError):  # closed meanwhile
            sockets.add(str(link.readlink()))
    tables = (Path(f"/proc/{pid}/net/{name}").read_text(encoding="ascii") for name in ("tcp", "tcp6"))
    rows = [line.split() for table in tables for line in table.splitlines()]
    return {row[1].partition(":")[0] for row in rows if row[3] == "0A" and f"socket:[{row[9]}]" in sockets}


@pytest.mark.live
@pytest.mark.parametrize(
    ("command", "ready", "addresses"),
    [
        ("monitor", "active", set()),
        ("daq --source sim", "active", set()),
        ("dashboard --port 0", "http://", {"0100007F"}),
        ("foxglove --port 0", "ws://", {"0100007F"}),
    ],
)
def test_a_command_listens_where_the_page_says(
    command: str,
    ready: str,
    addresses: set[str],
    own_domain: int,  # noqa: ARG001
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    words = [sys.executable, "-m", "scara_effmass", *command.split()]
    with Forked(words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as process:
        try:
            assert process.stdout is not None
            assert any(ready in line for line in process.stdout)
            assert listening(process.pid) == addresses
        finally:
            process.kill()


def test_no_template_of_a_report_switches_escaping_off() -> None:
    templates = sorted((ROOT / "scara_effmass/analysis/templates").glob("*.html"))
    assert len(templates) > 5
    assert environment("en").autoescape is True
    for path in templates:
        assert not re.search(r"\|\s*safe\b|autoescape|Markup", path.read_text(encoding="utf-8")), path.name


@given(st.text(min_size=1).map(lambda text: f"<img src=x onerror=alert(1)>{text}</script>\"'&"))
def test_markup_in_a_text_of_a_page_stays_text(text: str) -> None:
    shown = environment("en").from_string('<p title="{{ text }}">{{ text }}</p>{{ text | t }}').render(text=text)
    assert "<img" not in shown
    assert "</script" not in shown
