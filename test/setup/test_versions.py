# SPDX-License-Identifier: Apache-2.0
"""Version and description are stated once; the locked requirements satisfy pyproject.toml."""

import re
import sys
from importlib.metadata import metadata, version
from itertools import chain
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import pytest
from packaging.requirements import Requirement

import scara_effmass

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).parents[2]
PYTHONS = ("3.10", "3.11", "3.12", "3.13")


def manifest(path: str) -> ET.Element:
    return ET.parse(ROOT / path).getroot()


def project() -> dict[str, Any]:
    return tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


def requirements_of(extra: str) -> list[str]:
    texts: list[str] = []
    for text in project()["project"]["optional-dependencies"][extra]:
        requirement = Requirement(text)
        is_ours = requirement.name == "scara_effmass"
        texts += chain(*map(requirements_of, sorted(requirement.extras))) if is_ours else [text]
    return texts


def direct_requirements(*extras: str) -> list[str]:
    return [*project()["project"]["dependencies"], *chain(*map(requirements_of, extras))]


def locked(python: str, name: str) -> dict[str, str]:
    """Return the versions that lock file `name` installs on a Python, by package."""
    lines = (ROOT / "requirements" / name).read_text(encoding="utf-8").splitlines()
    requirements = [Requirement(line.removesuffix(" \\")) for line in lines if line and not line.startswith(("#", " "))]
    environment = {"python_version": python, "python_full_version": f"{python}.0", "sys_platform": "linux"}
    versions: dict[str, str] = {}
    for requirement in requirements:
        if requirement.marker is None or requirement.marker.evaluate(environment):
            assert requirement.name not in versions, f"{requirement.name} twice on Python {python}"
            versions[requirement.name] = str(requirement.specifier).removeprefix("==")
    return versions


def test_both_packages_have_the_installed_version() -> None:
    assert manifest("package.xml").findtext("version") == version("scara_effmass") == scara_effmass.__version__
    assert manifest("msg_schemas/package.xml").findtext("version") == version("scara_effmass")


def test_description_comes_from_the_manifest() -> None:
    assert metadata("scara_effmass")["Summary"] == manifest("package.xml").findtext("description")


def test_changelog_and_citation_have_the_version() -> None:
    assert f"\nversion: {version('scara_effmass')}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert f"\n## [{version('scara_effmass')}] - " in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("python", PYTHONS)
@pytest.mark.parametrize(
    ("lock", "extras", "groups"),
    [
        ("setup.lock", ["dashboard", "reports", "sim"], ["build"]),
        ("test.lock", ["dev"], ["build"]),
        ("colcon.lock", [], ["build", "colcon"]),
    ],
)
def test_lock_satisfies_requirements(python: str, lock: str, extras: list[str], groups: list[str]) -> None:
    versions = locked(python, lock)
    table = project()
    requirements = [*direct_requirements(*extras), *table["build-system"]["requires"]]
    for text in requirements + [text for group in groups for text in table["dependency-groups"][group]]:
        requirement = Requirement(text)
        name = re.sub(r"[-_.]+", "-", requirement.name).lower()
        assert requirement.specifier.contains(versions[name]), f"{lock}: {name} {versions[name]}, must be {text}"


@pytest.mark.parametrize("python", PYTHONS)
def test_locks_agree(python: str) -> None:
    tests, colcon = locked(python, "test.lock"), locked(python, "colcon.lock")
    assert {name: colcon[name] for name in tests.keys() & colcon} == {
        name: tests[name] for name in tests.keys() & colcon
    }
    assert locked(python, "setup.lock").items() <= tests.items()  # so the tests only add to `make setup`


def test_set_up_installs_nothing_of_the_tests() -> None:
    assert not {"pytest", "mypy", "ruff", "playwright", "moto", "duckdb"} & locked("3.11", "setup.lock").keys()


@pytest.mark.parametrize(("lock", "least"), [("setup", 150), ("test", 200), ("colcon", 150), ("tools", 50), ("uv", 1)])
def test_every_locked_requirement_has_its_hashes(lock: str, least: int) -> None:
    text = (ROOT / f"requirements/{lock}.lock").read_text(encoding="utf-8")
    requirements = re.findall(r"^[a-z0-9].*(?:\n {4}.*)*", text, re.MULTILINE)
    without = [item.split()[0] for item in requirements if not re.search(r" --hash=sha256:[0-9a-f]{64}$", item)]
    assert len(requirements) >= least
    assert not without


def test_set_up_checks_the_hashes() -> None:
    text = (ROOT / "scripts/install_locked.sh").read_text(encoding="utf-8")
    assert text.count("--require-hashes") == len(re.findall(r"\bpip install\b", text)) == 2  # pip, uv


def test_locks_contain_no_host_and_no_path() -> None:
    paths = sorted((ROOT / "requirements").iterdir())
    assert len(paths) == 5
    for path in paths:
        text = path.read_text(encoding="utf-8")
        assert not re.search(r"://|@ |^-|^/", text, re.MULTILINE), path.name


@pytest.mark.parametrize("requirement", direct_requirements("all"))
def test_decisions_explain_every_direct_dependency(requirement: str) -> None:
    name = Requirement(requirement).name
    assert re.search(rf"\b{re.escape(name)}\b", (ROOT / "docs/decisions.md").read_text(encoding="utf-8"), re.IGNORECASE)
