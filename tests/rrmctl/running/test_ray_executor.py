"""What a task does on its node, and what is told of runs by their files; tests/cluster has a real Ray."""

from __future__ import annotations

import dataclasses
import os
import signal
import socket
import sys
import threading
import time
from pathlib import Path

import pytest
import ray

from rrmctl.running.executor import Evaluated, Progress, Started, WorkOrder
from rrmctl.running.ray_executor import RayExecutor, Seen, attempt, connected
from rrmctl.running.scheduler import Stage
from rrmctl.store.provenance import read_config
from rrmctl.store.records import write_json
from rrmctl.store.status import ErrorKind, RunState, Status, read_status, write_status
from tests.rrmctl.running.standin import COMMAND, prepare


def test_an_attempt(tmp_path: Path) -> None:
    """A worker is started, waited for, and what it noted comes back."""
    _, (job,) = prepare(tmp_path, range(1))
    notes, outcome = attempt(str(tmp_path), WorkOrder(run=job.id, threads=1), 60.0, None, COMMAND)
    assert (outcome.ending, notes) == (Stage.DONE, ["from step 0"])
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_attempt_that_is_cancelled(tmp_path: Path, number: signal.Signals) -> None:
    """SIGINT, by which Ray cancels, and SIGTERM, by which it stops a node, have the worker checkpoint."""
    layout, (job,) = prepare(tmp_path, range(1), steps=100_000)

    def cancel() -> None:
        while read_status(layout.run(job.id)).rows == 0:
            time.sleep(0.05)
        os.kill(os.getpid(), number)

    threading.Thread(target=cancel).start()
    _, outcome = attempt(str(tmp_path), WorkOrder(run=job.id, threads=1), 60.0, None, COMMAND)
    assert outcome.ending is Stage.STOPPED
    assert read_status(layout.run(job.id)).state is RunState.INTERRUPTED
    assert (layout.run(job.id).checkpoint / "step").exists()


def test_a_request_to_stop_while_ray_begins(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ray's handler of SIGTERM leaves with 15; ours hears of it all the same."""
    heard: list[int] = []

    def init(**_options: object) -> None:
        signal.signal(signal.SIGTERM, lambda number, _frame: sys.exit(number))
        os.kill(os.getpid(), signal.SIGTERM)

    def take(number: int, _frame: object) -> None:
        heard.append(number)

    monkeypatch.setattr(ray, "init", init)
    monkeypatch.setattr(ray, "shutdown", lambda: None)
    before = signal.signal(signal.SIGTERM, take)
    try:
        with connected(None):
            assert heard == [signal.SIGTERM]
        assert signal.getsignal(signal.SIGTERM) is take
    finally:
        signal.signal(signal.SIGTERM, before)


def test_a_node_that_does_not_see_the_results(tmp_path: Path) -> None:
    """It is named, and the sweep stops: the run is not to blame."""
    _, outcome = attempt(str(tmp_path / "elsewhere"), WorkOrder(run="0" * 16, threads=1), 60.0, None, COMMAND)
    assert outcome.error is not None
    assert outcome.error.kind is ErrorKind.STORAGE
    assert outcome.error.message.startswith(f"on {socket.gethostname()}: ")


def test_what_files_tell(tmp_path: Path) -> None:
    """Each thing once: that a worker has it, with the evaluations that it can have begun with, and how far it is."""
    layout, (job,) = prepare(tmp_path, range(1))
    folder, before = layout.run(job.id), Status(state=RunState.INTERRUPTED, attempt=1, step=20, steps=40, rows=2)
    write_status(folder, before)
    seen = Seen(job.id, before)
    assert list(seen.news(layout)) == []
    now = dataclasses.replace(before, state=RunState.RUNNING, attempt=2, rows=3, step=30, steps_per_s=9.0, success=0.5)
    write_status(folder, now)
    told = [Started(job.id, 2, 2), Progress(job.id, 30, 9.0), Evaluated(job.id, 30, 0.5, None)]
    assert list(seen.news(layout)) == told
    assert list(seen.news(layout)) == []
    folder.status.write_text("{")
    assert list(seen.news(layout)) == []


def test_what_a_run_takes_of_its_node(tmp_path: Path) -> None:
    """Its threads; and its share of a card, if it is trained on one."""
    layout, (job, other) = prepare(tmp_path, range(2))
    write_json(layout.run(other.id).config, read_config(layout.run(other.id)) | {"device": "cuda"})
    executor = RayExecutor(layout=layout, gpus=0.25, memory_limit=2**30)
    assert [executor.needs(each.id, 2) for each in (job, other)] == [
        {"CPU": 2, "GPU": share, "memory": 2**30} for share in (0.0, 0.25)
    ]
