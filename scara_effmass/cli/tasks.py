# SPDX-License-Identifier: Apache-2.0
"""Run the tasks of a command, one per bag or part: in this process, in local processes, or on a Dask scheduler."""

from __future__ import annotations

import argparse
import logging
import os
import signal
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn

from scara_effmass import __version__
from scara_effmass.cli.console import progress_bar
from scara_effmass.errors import BagError, EffmassError, SettingsError
from scara_effmass.extras import pip_line

if TYPE_CHECKING:
    from distributed import Future

Task = TypeVar("Task")
Result = TypeVar("Result")
Advance = Callable[[float], object]
"""Takes the share of a task that is done since the last call."""

CONNECT_S = 10.0
"""Longest time until a scheduler answers and has a worker."""
LOST_S = 60.0
"""Time without any worker after which a run ends."""
SMALL_BYTES = 100_000_000
"""Size of recordings below which the start of local processes takes longer than they save."""


class Run(Protocol):
    """Runs a function on each of many tasks."""

    def __call__(
        self, function: Callable[[Task, Advance], Result], tasks: Sequence[Task]
    ) -> Iterator[Result | EffmassError]:
        """Yield the result of `function` for each task in order, or the error that it raised."""


@contextmanager
def open_run(args: argparse.Namespace, name: str, *, is_small: bool = False) -> Iterator[Run]:
    """Give a function that runs the tasks of a command; `name` is what the progress bar counts. Use it in a `with`.

    A single task, small work without --jobs, and --jobs 1 run in this process, without workers. Function, tasks and
    results must be picklable. Running raises SettingsError where the scheduler does not answer, has no worker or runs
    another version.
    """
    if args.scheduler and (args.jobs or args.memory_limit):
        raise SettingsError(f"--scheduler = {args.scheduler}: must be without --jobs and --memory-limit")
    columns = TextColumn(name), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
    with ExitStack() as stack:
        progress = stack.enter_context(progress_bar(*columns))

        def run(function: Callable[[Task, Advance], Result], tasks: Sequence[Task]) -> Iterator[Result | EffmassError]:
            advance = partial(progress.advance, progress.add_task("", total=len(tasks)))
            jobs = min(args.jobs or (1 if is_small else len(os.sched_getaffinity(0))), len(tasks))
            serial = (_attempt(function, task, advance) for task in tasks)
            if args.scheduler is None and jobs <= 1:
                return serial
            if not find_spec("distributed"):
                install = f"need Dask: {pip_line('distributed')}"
                if args.scheduler is not None:
                    raise SettingsError(f"--scheduler = {args.scheduler}: {install}")
                print(f"runs in one process; several {install}", file=sys.stderr)  # noqa: T201
                return serial
            client: Any = stack.enter_context(
                _remote(args.scheduler) if args.scheduler else _local(jobs, args.memory_limit)
            )
            dashboard = client.dashboard_link if find_spec("bokeh") else "none, bokeh is not installed"
            where = f"workers: {len(client.nthreads())} of {client.scheduler.address}; dashboard: {dashboard}"
            if progress.console.is_terminal:
                progress.console.print(where, highlight=False)
            return _submitted(client, function, tasks, advance)

        yield run


def raised(outcome: Result | EffmassError) -> Result:
    """Return a result. Raises the error of a bad task."""
    if isinstance(outcome, EffmassError):
        raise outcome
    return outcome


def sound(
    tasks: Sequence[Task],
    outcomes: Iterable[Result | EffmassError],
    errors: list[str],
    kind: type[EffmassError] = BagError,
) -> Iterator[tuple[Task, Result]]:
    """Yield each task that succeeded with its result, and append errors of `kind` (bad recordings) to `errors`.

    Raises an error of `kind` if all tasks have one, and any other error at once.
    """
    for task, outcome in zip(tasks, outcomes, strict=True):
        if isinstance(outcome, kind):
            errors.append(str(outcome))
            if len(errors) == len(tasks):
                raise kind("; ".join(errors))
        else:
            yield task, raised(outcome)


def _attempt(function: Callable[[Task, Advance], Result], task: Task, advance: Advance) -> Result | EffmassError:
    try:
        return function(task, advance)
    except EffmassError as error:
        return error


def _ignore(_share: float) -> None:
    """Do not show the progress within a task of another process."""


def _submitted(
    client: Any,  # noqa: ANN401 - Dask has no types
    function: Callable[[Task, Advance], Result],
    tasks: Sequence[Task],
    advance: Advance,
) -> Iterator[Any]:
    """Yield the results of `client` in order. Each thread has one task, so that its death is blamed on no other."""
    from distributed import wait  # noqa: PLC0415 - takes a second, as every import of Dask

    waiting, pending, finished = iter(enumerate(tasks)), dict[Any, tuple[int, Task]](), dict[int, Any]()
    next_number = 0
    while next_number < len(tasks):
        free = max(sum(client.nthreads().values()), 1) - len(pending)
        for _, item in zip(range(free), waiting, strict=False):
            pending[client.submit(_attempt, function, item[1], _ignore, pure=False)] = item
        try:
            done = wait([*pending], LOST_S, "FIRST_COMPLETED").done  # type: ignore[no-untyped-call]
        except TimeoutError:
            if client.nthreads():
                continue
            raise SettingsError(f"{client.scheduler.address}: has no worker for {LOST_S:g} s: must have one") from None
        for future in done:
            number, task = pending.pop(future)
            finished[number] = _result(future, task)
            advance(1.0)
        while next_number in finished:
            yield finished.pop(next_number)
            next_number += 1


def _result(future: Future[Any], task: object) -> object:
    from distributed import KilledWorker  # noqa: PLC0415

    try:
        return future.result()
    except KilledWorker as killed:
        times = f"ended {killed.allowed_failures + 1} worker processes"
        return BagError(f"{task}: {times}: must fit into the memory of a worker, see --memory-limit")


@contextmanager
def _local(jobs: int, memory_gb: float | None) -> Iterator[Any]:
    """Give a client of `jobs` processes that this process starts and ends, reachable from this machine only."""
    from distributed import Client, LocalCluster  # noqa: PLC0415

    ignore, interrupts = "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN)", list[int]()
    # This process ends the workers: they inherit that Ctrl-C does not reach them, and restarted ones preload it.
    handler = signal.signal(signal.SIGINT, lambda number, _: interrupts.append(number))
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        cluster = LocalCluster(  # type: ignore[no-untyped-call]
            n_workers=jobs,
            threads_per_worker=1,
            host="127.0.0.1",
            dashboard_address="127.0.0.1:0",
            memory_limit="auto" if memory_gb is None else round(memory_gb * 1e9),
            preload=ignore,
            silence_logs=logging.CRITICAL,
        )
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        signal.signal(signal.SIGINT, handler)
    with cluster, Client(cluster) as client:  # type: ignore[no-untyped-call]
        if interrupts:
            raise KeyboardInterrupt
        yield client


@contextmanager
def _remote(address: str) -> Iterator[Any]:
    """Give a client of the scheduler at `address`; TLS is as configured for Dask. Raises SettingsError."""
    from distributed import Client  # noqa: PLC0415

    with ExitStack() as stack:
        try:
            client = Client(address, timeout=CONNECT_S)  # type: ignore[no-untyped-call]
            stack.enter_context(client)
            client.wait_for_workers(1, timeout=CONNECT_S)
            versions = {*client.run(_version).values()}
        except Exception as error:  # noqa: BLE001 - also what a worker without this package raises
            raise SettingsError(f"--scheduler = {address}: must answer and have a worker: {error}") from None
        if versions != {__version__}:
            raise SettingsError(f"--scheduler = {address}: has workers of {min(versions)}: must be of {__version__}")
        yield client


def _version() -> str:
    return __version__
