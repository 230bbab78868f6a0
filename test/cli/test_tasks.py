# SPDX-License-Identifier: Apache-2.0
"""Commands over many bags: the same result in one process, in local ones and on a Dask scheduler; ends of workers."""

import json
import os
import signal
import subprocess
import sys
import time
from argparse import Namespace
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import dask
import pytest
from distributed import LocalCluster
from pyarrow import parquet

from scara_effmass.bags.files import open_bag
from scara_effmass.bags.writer import BagWriter
from scara_effmass.cli.tasks import Advance, open_run
from scara_effmass.errors import BagError
from scara_effmass.share import share
from test.cli.conftest import Cli, swing

pytestmark = pytest.mark.live

STATES = 300
LOCAL: dict[str, Any] = {"threads_per_worker": 1, "host": "127.0.0.1", "dashboard_address": "127.0.0.1:0"}


def make_bags(folder: Path, names: str) -> Path:
    """Write a recording of a cell for each letter."""
    for number, name in enumerate(names):
        with BagWriter(folder / "cell=A7" / name) as bag:
            bag.write_joint_states("/joint_states", swing(STATES + number))
    return folder / "cell=A7"


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two recordings, and between them a bad one."""
    folder = make_bags(tmp_path_factory.mktemp("bags"), "ac")
    (folder / "b.mcap").write_bytes(b"no bag")
    return folder


@pytest.fixture(scope="module")
def scheduler() -> Iterator[str]:
    """Address of a Dask scheduler with two workers."""
    with LocalCluster(**LOCAL, n_workers=2) as cluster:  # type: ignore[no-untyped-call]
        yield cluster.scheduler_address


def is_group_alive(group: int) -> bool:
    """Return whether a process of the group is alive."""
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True


def files(folder: Path) -> dict[str, bytes]:
    """Return the files in a folder, without SVG, whose numbers depend on what was drawn before."""
    paths = (path for path in folder.rglob("*") if path.is_file() and path.suffix != ".svg")
    return {str(path.relative_to(folder)): path.read_bytes() for path in paths}


@pytest.mark.usefixtures("unrendered")
def test_result_does_not_depend_on_where_it_is_computed(bags: Path, scheduler: str, cli: Cli, tmp_path: Path) -> None:
    commands = {"a.parquet": "assess", "a.csv": "assess", "a.mcap": "assess", "coverage": "coverage", "data": "assess"}
    places = {"one": ("--jobs", "1"), "remote": ("--scheduler", scheduler), "local": ("--jobs", "2")}
    results: dict[str, list[dict[str, object]]] = {}
    for place, options in places.items():
        for output, command in commands.items():
            if place == "local" and output != "data":
                continue  # each starts its processes
            done = cli(command, bags, "-o", output, *options, "--json")
            assert (done.returncode, done.stderr) == (1, "")
            results.setdefault(output, []).append(json.loads(done.stdout))
            (tmp_path / place).mkdir(exist_ok=True)
            (tmp_path / output).rename(tmp_path / place / output)
    assert all(others == [first] * len(others) for first, *others in results.values())
    bad = f"{bags / 'b.mcap'}: is not a bag; expected MCAP, SQLite (rosbag2) or ROS 1"
    assert all(result["unreadable"] == [bad] for result, *_ in results.values())
    one, remote, local = (files(tmp_path / place) for place in places)
    assert one == remote
    assert {name: content for name, content in one.items() if name.startswith("data/")} == local
    assert {name for name in one if name.endswith("parquet") and "=" in name} == {
        next(name for name in one if name.startswith(f"data/cell=A7/day=2026-01-01/{bag}-")) for bag in "ac"
    }
    table = parquet.read_table(tmp_path / "one" / "a.parquet")
    with open_bag(tmp_path / "one" / "a.mcap") as bag:
        # One message per joint state, one row per contact point of it.
        points = len(set(table["contact_point"].to_pylist()))
        assert sum(topic.count for topic in bag.topics) == table.num_rows // points + 1
    parts = parquet.read_table(tmp_path / "one" / "data").select(table.column_names)
    assert parts.schema.equals(table.schema)
    assert repr(parts.to_pylist()) == repr(table.to_pylist())  # a mass that is not there is NaN


@pytest.mark.usefixtures("unrendered")
def test_validation_does_not_depend_on_where_it_is_computed(scheduler: str, cli: Cli, tmp_path: Path) -> None:
    runs = [share("bags", "campaign") / f"{name}_500g_1" for name in ("300_200", "300_0")]
    for name, place in {"one": ("--jobs", "1"), "two": ("--scheduler", scheduler)}.items():
        cli("validate", *runs, "-o", name, *place)
    assert files(tmp_path / "one") == files(tmp_path / "two")


def test_maps_do_not_depend_on_where_they_are_computed(scheduler: str, cli: Cli, tmp_path: Path) -> None:
    robots = [share("config", *name.split("/")) for name in ("omron_i4_550l.yaml", "robots/ur5_robot.urdf")]
    for name, place in {"one": ("--jobs", "1"), "two": ("--scheduler", scheduler)}.items():
        done = cli("map", *robots, "-o", name, "--model", "full", "--samples", "100", *place)
        assert (done.returncode, done.stderr) == (0, "")
    assert files(tmp_path / "one") == files(tmp_path / "two")
    assert len(files(tmp_path / "one")) == 6


@pytest.mark.usefixtures("unrendered")
def test_evidence_does_not_depend_on_where_it_is_computed(scheduler: str, cli: Cli, tmp_path: Path) -> None:
    for name, place in {"one": ("--jobs", "1"), "two": ("--scheduler", scheduler)}.items():
        done = cli("evidence", "-o", name, "--impacts", "3", *place)
        assert (done.returncode, done.stderr) == (0, "")
    assert files(tmp_path / "one") == files(tmp_path / "two")


def test_end_of_a_worker_is_survived_and_a_task_that_causes_it_is_reported(tmp_path: Path) -> None:
    def act(kind: str, advance: Advance) -> tuple[str, bool]:
        """Do what the name of the task says."""
        marker = tmp_path / kind
        is_first = not marker.exists()
        marker.touch()
        if kind == "kills its worker" or (kind == "is killed once" and is_first):
            os.kill(os.getpid(), signal.SIGKILL)
        if kind == "needs 2 GB":
            memory = b"x" * 2_000_000_000
            while memory:
                advance(0.0)
        return kind, "rclpy" in sys.modules

    kinds = ["works", "is killed once", "kills its worker", "needs 2 GB", "works"]
    args = Namespace(scheduler=None, jobs=2, memory_limit=1.0)
    with dask.config.set({"distributed.scheduler.allowed-failures": 1}), open_run(args, "tasks") as run:
        # Apart, because Dask also counts the end of a worker at which a repeated task only waits.
        outcomes = [*run(act, kinds[:2]), *run(act, kinds[2:])]
    assert outcomes[:2] == [("works", False), ("is killed once", False)]  # rclpy is not inherited
    assert outcomes[4] == ("works", False)
    for kind, outcome in zip(kinds[2:4], outcomes[2:4], strict=True):
        assert isinstance(outcome, BagError)
        assert str(outcome).startswith(f"{kind}: ended 2 worker processes: must fit into the memory of a worker")


def test_interrupt_while_the_workers_start_is_not_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    clusters = []

    def start(**options: Any) -> LocalCluster:  # noqa: ANN401
        os.kill(os.getpid(), signal.SIGINT)
        clusters.append(LocalCluster(**options))  # type: ignore[no-untyped-call]
        return clusters[0]

    monkeypatch.setattr("distributed.LocalCluster", start)
    with (
        pytest.raises(KeyboardInterrupt),
        open_run(Namespace(scheduler=None, jobs=2, memory_limit=None), "tasks") as run,
    ):
        run(lambda task, _: task, ["a", "b"])
    assert (clusters[0].status.name, clusters[0].workers) == ("closed", {})


def test_interrupted_dataset_is_continued(tmp_path: Path, cli: Cli, domain: dict[str, str]) -> None:
    words = ("assess", make_bags(tmp_path, "abcdefghijkl"), "-o", tmp_path / "dataset", "--jobs", "2")
    records = tmp_path / "dataset" / "_results"
    with subprocess.Popen(
        [sys.executable, "-m", "scara_effmass", *map(str, words)],
        env=domain,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as process:
        while not list(records.glob("cell=*/*.json")):
            assert process.poll() is None
            time.sleep(0.05)
        os.killpg(process.pid, signal.SIGINT)  # as a terminal does
        output, errors = process.communicate(timeout=60)
    assert (process.returncode, output, errors) == (130, "", "interrupted\n")
    while is_group_alive(process.pid):  # until no worker is left
        time.sleep(0.05)
    first = {path: path.stat().st_mtime_ns for path in (tmp_path / "dataset").rglob("*.*")}
    assert not [path for path in first if path.name.startswith(".")]
    done = [path for path in first if path.suffix == ".json"]
    assert 0 < len(done) < 12
    result = json.loads(cli(*words[:-2], "--json").stdout)
    assert (result["joint_states"], result["unreadable"]) == (12 * STATES + 66, [])
    assert {path: path.stat().st_mtime_ns for path in done} == {path: first[path] for path in done}
    assert json.loads(cli(*words[:-2], "--json").stdout) == result  # nothing is assessed a third time
    other = cli(*words, "--region", "chest")
    assert other.returncode == 2
    assert "is of other settings, robot or version; use --force to replace it" in other.stderr


def test_scheduler_that_does_not_answer_is_named(
    bags: Path, refused: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("scara_effmass.cli.tasks.CONNECT_S", 0.2)
    words = ("assess", bags / "a", "-o", "a.csv", "--scheduler")
    assert "--scheduler = tcp://127.0.0.1:1: must answer and have a worker" in refused(*words, "tcp://127.0.0.1:1")
    with LocalCluster(**LOCAL, n_workers=0) as cluster:  # type: ignore[no-untyped-call]
        line = refused(*words, cluster.scheduler_address)
    assert "must answer and have a worker" in line


def test_without_dask_one_process_does_it_and_says_so(
    bags: Path, cli: Cli, refused: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("scara_effmass.cli.tasks.find_spec", lambda _: None)
    done = cli("assess", bags / "a", bags / "c", "-o", "a.csv", "--jobs", "2")
    assert done.returncode == 0
    assert done.stderr == "runs in one process; several need Dask: pip install 'scara_effmass[cluster]'\n"
    assert "--scheduler = tcp://a:1: need Dask" in refused(
        "assess", bags / "a", "-o", "b.csv", "--scheduler", "tcp://a:1"
    )


def test_dataset_loses_what_killed_processes_left_of_its_recordings(tmp_path: Path, cli: Cli) -> None:
    day = tmp_path / "dataset" / "cell=A7" / "day=2026-01-01"
    day.mkdir(parents=True)
    left, other = day / ".a-0123456789abcdef-4194304.parquet", day / ".another-0123456789abcdef-4194304.parquet"
    left.touch()
    other.touch()
    assert cli("assess", make_bags(tmp_path, "a"), "-o", tmp_path / "dataset").returncode == 0
    assert [path.name for path in day.glob(".*")] == [other.name]
