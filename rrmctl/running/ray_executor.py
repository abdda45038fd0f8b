"""The executor of a Ray cluster: one of its tasks for each attempt, on whatever node has room.

A task starts the worker as a machine of its own would and waits for it; how far that is, the results folder tells,
which every node sees at the same path. Ray tries nothing again: a node that is lost ends an attempt as a signal from
outside does, and what follows the supervisor decides. When this process dies, or a node's Ray, workers notice that
their task is gone, write a checkpoint and leave.
"""

from __future__ import annotations

import contextlib
import logging
import os
import signal
import socket
import sys
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import ray
from ray.exceptions import OutOfMemoryError, RayError, RayTaskError, TaskCancelledError

from rrm.hardware import usable_cores
from rrmctl.errors import UserError
from rrmctl.running.config_file import on_card
from rrmctl.running.executor import Ended, Evaluated, Event, Note, Progress, Started, WorkOrder
from rrmctl.running.local import WORKER, LocalExecutor
from rrmctl.running.scheduler import Outcome, Stage
from rrmctl.store.files import StorageError
from rrmctl.store.layout import Layout
from rrmctl.store.status import ErrorKind, RunError, RunState, Status, read_status, run_status

#: Time between two looks at the status of runs, seconds: the first, and so much more for each run.
_LOOK_S = 0.5
_LOOK_RUN_S = 0.01

#: How long the end of a run may take to be seen from here, seconds: file systems keep what they saw last for a while.
_SEEN_S = 15.0

#: How long the cluster's head may take to answer, seconds.
_REACH_S = 10.0

#: For Ray's workers: by itself one that leaves kills what it has started, before that can write a checkpoint.
_SPARING = {"env_vars": {"RAY_kill_child_processes_on_worker_exit": "false"}}

#: How long a task waits for its worker between two looks at what it is asked, seconds.
_TICK_S = 0.2


@contextlib.contextmanager
def connected(address: str | None) -> Iterator[None]:
    """Be a driver of the cluster there, or of one of this machine alone that ends with it; UserError: there is none."""
    own: dict[str, Any] = {"address": "local", "num_cpus": usable_cores(), "include_dashboard": False}
    if address:
        _reach(address)
    before, asked = signal.getsignal(signal.SIGTERM), False
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # it would tell its makers
    try:
        try:
            ray.init(**({"address": address} if address else own), log_to_driver=False, logging_level=logging.ERROR)
        finally:
            signal.signal(signal.SIGTERM, before)  # Ray's would end this process
    except SystemExit:  # as it does, where SIGTERM came before ours was back
        signal.signal(signal.SIGTERM, before)
        asked = True
    except (ConnectionError, ValueError, RuntimeError, RayError) as error:
        reason = " ".join(str(error).split())
        where = f"the Ray cluster at {address}" if address else "Ray"
        hint = "has this machine begun to be a node of it, with this version, and RAY_AUTH_TOKEN where it wants one?"
        raise UserError(f"{where} cannot be used: {reason}", hint) from error
    try:
        if asked:
            signal.raise_signal(signal.SIGTERM)
        with contextlib.redirect_stdout(sys.stderr):  # where Ray tells of nodes that it lost
            yield
    finally:
        ray.shutdown()


def _reach(address: str) -> None:
    """Ray itself would try for a quarter of an hour."""
    host, _, port = address.rpartition(":")
    if not host or not port.isdecimal() or "/" in host:
        raise UserError(f'"{address}" is not the address of a Ray cluster', "name it as HOST:PORT, such as head:6379")
    try:
        socket.create_connection((host, int(port)), _REACH_S).close()
    except (OSError, OverflowError) as error:
        begin = f"`ray start --head --port={port}` begins one"
        raise UserError(f"there is no Ray cluster at {address}: {error}", begin) from None


@dataclass
class Seen:
    """What is known of an attempt."""

    run: str
    status: Status

    def news(self, layout: Layout) -> Iterator[Event]:
        """What its status tells that it did not tell before."""
        with contextlib.suppress(UserError):  # damaged or not readable now: its worker mends it
            before, now = self.status, read_status(layout.run(self.run))
            self.status = now
            if now.attempt > before.attempt:  # it may have come further since then than it was before
                yield Started(self.run, now.attempt, min(before.rows, now.rows))
            if now.step != before.step:
                yield Progress(self.run, now.step, now.steps_per_s)
            if now.rows != before.rows:
                yield Evaluated(self.run, now.step, now.success, now.true_return)


class _Ended(NamedTuple):
    """An attempt that has ended, told by its task before files may tell it here."""

    seen: Seen
    notes: list[str]
    outcome: Outcome
    until: float  #: when that is no longer waited for


@dataclass(kw_only=True)
class RayExecutor:
    """An `rrmctl.running.executor.Executor`, inside `connected`."""

    layout: Layout
    hang_after_s: float = 1800.0  #: see `LocalExecutor`
    memory_limit: int | None = None  #: bytes that a worker may take, and that Ray keeps for it; None: neither
    gpus: float = 1.0  #: of a card, for a run that is trained on one; below 1 several share it
    command: Sequence[str] = ()  #: as in `LocalExecutor`; none: its default on the node
    _task: Any = field(default_factory=lambda: ray.remote(max_retries=0, runtime_env=_SPARING)(attempt), init=False)
    _attempts: dict[Any, Seen] = field(default_factory=dict, init=False)  # by the result that is waited for
    _ended: list[_Ended] = field(default_factory=list, init=False)  # whose files are not seen to say so
    _stopping: bool = field(default=False, init=False)
    _look_at: float = field(default=0.0, init=False)  # when statuses are to be looked at again

    def needs(self, run: str, threads: int) -> dict[str, float]:
        """What a run takes of its node, by the names that Ray gives nodes' resources."""
        cards = self.gpus if on_card(self.layout.run(run)) else 0.0
        return {"CPU": threads, "GPU": cards, "memory": self.memory_limit or 0}

    def submit(self, order: WorkOrder) -> None:
        needs = self.needs(order.run, order.threads)
        task = self._task.options(num_cpus=needs["CPU"], num_gpus=needs["GPU"], memory=needs["memory"] or None)
        seen = Seen(order.run, run_status(self.layout.run(order.run)))
        root = str(self.layout.root.absolute())
        self._attempts[task.remote(root, order, self.hang_after_s, self.memory_limit, self.command)] = seen

    def events(self, wait_s: float) -> Iterator[Event]:
        if not self._attempts:
            time.sleep(wait_s)
        elif ray.wait([*self._attempts], timeout=wait_s)[0]:
            results, _ = ray.wait([*self._attempts], num_returns=len(self._attempts), timeout=0)
            until = time.monotonic() + _SEEN_S
            self._ended += [_Ended(self._attempts.pop(result), *self._result(result), until) for result in results]
        if time.monotonic() >= self._look_at:
            self._look_at = time.monotonic() + _LOOK_S + _LOOK_RUN_S * len(self._attempts)
            for seen in self._attempts.values():
                yield from seen.news(self.layout)
        self._ended, ended = [], self._ended
        for each in ended:
            yield from each.seen.news(self.layout)
            unseen = each.outcome.ending is Stage.DONE and each.seen.status.state is not RunState.DONE
            if unseen and time.monotonic() < each.until:
                self._ended.append(each)
                continue
            yield from (Note(each.seen.run, text) for text in each.notes)
            yield Ended(each.seen.run, each.outcome)

    @property
    def running(self) -> int:
        return len(self._attempts) + len(self._ended)

    def stop(self, *, now: bool = False) -> None:
        self._stopping = True
        for result in self._attempts:
            ray.cancel(result, force=now)  # those that have no node yet end at once; the others get SIGINT

    def close(self) -> None:
        self.stop(now=True)
        if self._attempts:
            ray.wait([*self._attempts], num_returns=len(self._attempts), timeout=_SEEN_S)
        self._attempts.clear()
        self._ended.clear()

    def _result(self, result: Any) -> tuple[list[str], Outcome]:
        try:
            notes, outcome = ray.get(result)
        except TaskCancelledError:
            return [], Outcome(Stage.STOPPED)
        except RayError as error:
            if self._stopping:
                return [], Outcome(Stage.STOPPED)  # ended for taking too long, or its node with it
            if isinstance(error, RayTaskError):  # of the task: workers tell what is wrong with runs in their own way
                text = f"a node cannot run it: {error}"
                return [], Outcome(Stage.FAILED, RunError(kind=ErrorKind.STORAGE, type="RayTaskError", message=text))
            kind = ErrorKind.MEMORY if isinstance(error, OutOfMemoryError) else ErrorKind.KILLED
            text = " ".join(str(error).split())
            return [], Outcome(Stage.FAILED, RunError(kind=kind, type=type(error).__name__, message=text))
        return notes, outcome


def attempt(
    root: str, order: WorkOrder, hang_after_s: float, memory_limit: int | None, command: Sequence[str] = ()
) -> tuple[list[str], Outcome]:
    """On a node: see a worker to its end. SIGINT, by which Ray cancels, and SIGTERM have it checkpoint and leave.

    Returns:
        What people should read, and how the attempt ended.
    """
    executor = LocalExecutor(
        layout=Layout(Path(root)), hang_after_s=hang_after_s, memory_limit=memory_limit, command=command or WORKER
    )
    asked: list[int] = []
    numbers = (signal.SIGINT, signal.SIGTERM)
    before = [signal.signal(number, lambda number, _frame: asked.append(number)) for number in numbers]
    try:
        executor.submit(order)
        return _seen_to_its_end(executor, asked)
    except StorageError as error:
        message = f"on {socket.gethostname()}: {error}"
        return [], Outcome(Stage.FAILED, RunError(kind=ErrorKind.STORAGE, type="StorageError", message=message))
    finally:
        executor.close()
        for number, handler in zip(numbers, before, strict=True):
            signal.signal(number, handler)


def _seen_to_its_end(executor: LocalExecutor, asked: list[int]) -> tuple[list[str], Outcome]:
    notes: list[str] = []
    while True:
        for event in executor.events(_TICK_S):
            match event:
                case Note(_, text):
                    notes.append(text)
                case Ended(_, outcome):
                    return notes, outcome
        if asked:
            asked.clear()
            executor.stop()


def misfits(needs: Iterable[Mapping[str, float]]) -> list[str]:
    """What no node of the cluster has, in words: of these resources, each wanted at once."""
    nodes = [node["Resources"] for node in ray.nodes() if node["Alive"]]  # type: ignore[no-untyped-call]
    wanted = {tuple(need.items()) for need in needs}
    return [
        f"{need['CPU']:g} cores"
        + (f", {need['GPU']:g} of a card" if need["GPU"] else "")
        + (f", {need['memory'] / 2**30:.1f} GiB" if need["memory"] else "")
        for need in map(dict, sorted(wanted))
        if not any(all(node.get(name, 0) >= amount for name, amount in need.items()) for node in nodes)
    ]
