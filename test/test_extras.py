# SPDX-License-Identifier: Apache-2.0
"""Base commands run without the libraries of the extras; any other command names the extra that it needs."""

import subprocess
import sys
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from scara_effmass.extras import EXTRAS, missing_extra
from scara_effmass.share import share

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

WITHOUT_EXTRAS = """
import sys
from scara_effmass.extras import EXTRAS
class Blocker:
    @staticmethod
    def find_spec(name, *_):
        if name.partition(".")[0] in EXTRAS:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
sys.meta_path.insert(0, Blocker)
"""
COMMAND = f"{WITHOUT_EXTRAS}from scara_effmass.__main__ import main; sys.exit(main())"
NODES = ("monitor", "daq", "validator", "speed_scaling", "visualization")


def run(code: str, *arguments: str | Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", code, *arguments], capture_output=True, check=False, text=True)


def test_table_agrees_with_the_extras_of_the_project() -> None:
    text = (Path(__file__).parents[1] / "pyproject.toml").read_text(encoding="utf-8")
    extras = tomllib.loads(text)["project"]["optional-dependencies"]
    names = {extra: {canonicalize_name(Requirement(line).name) for line in lines} for extra, lines in extras.items()}
    distributions = packages_distributions()
    for library, extra in EXTRAS.items():
        # fsspec comes with s3fs, distributed with Dask.
        known = {canonicalize_name(name) for name in distributions.get(library, [library])} | {"fsspec": {"s3fs"}}.get(
            library, set()
        )
        assert known & names[extra] or library == "distributed", library
    assert set(EXTRAS.values()) | {"all", "dev"} == set(extras)
    (together,) = map(Requirement, extras["all"])
    assert together.extras == set(extras) - {"all", "dev"}


def test_only_optional_libraries_have_an_extra() -> None:
    assert missing_extra(ModuleNotFoundError(name="yaml")) == ""
    assert missing_extra(ModuleNotFoundError(name="nptdms.log")) == (
        "nptdms: must be installed: pip install 'scara_effmass[daq]'"
    )


@pytest.mark.live
def test_base_commands_run_without_extras(tmp_path: Path) -> None:
    table = tmp_path / "tour.parquet"
    for command in (
        ("limits",),
        ("doctor",),
        ("lump", "--poses", "10"),
        ("assess", share("bags", "tour"), "-o", table),
    ):
        done = run(COMMAND, *command)
        assert (done.returncode, done.stderr) == (0, ""), command
        assert done.stdout
    assert table.is_file()


@pytest.mark.live
def test_nodes_load_without_extras() -> None:
    imports = "\n".join(f"import scara_effmass.nodes.{name}_node" for name in NODES)
    done = run(WITHOUT_EXTRAS + imports)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.live
@pytest.mark.parametrize(
    ("command", "extra"),
    [
        ("map -o map", "reports"),
        ("lump -o lump", "reports"),
        ("validate BAG -o validation", "reports"),
        ("assess BAG -o tour.csv --report report", "reports"),
        ("campaign -o campaign", "sim"),
        ("sim", "sim"),
        ("import force.tdms -o force", "daq"),
        ("dashboard", "dashboard"),
        ("foxglove", "foxglove"),
    ],
)
def test_command_without_its_extra_names_it_and_exits_with_2(
    command: str, extra: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("force.tdms").touch()
    done = run(COMMAND, *command.replace("BAG", str(share("bags", "tour"))).split())
    (line,) = done.stderr.splitlines()
    assert line.endswith(f": must be installed: pip install 'scara_effmass[{extra}]'")
    assert (done.returncode, done.stdout) == (2, "")
    assert [path.name for path in tmp_path.iterdir()] == ["force.tdms"]
