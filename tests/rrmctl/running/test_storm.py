"""A hundred short jobs, twenty workers, one of them killed every second, and readers that never rest."""

from __future__ import annotations

import os
import random
import re
import signal
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pandas as pd
import pytest
from typer.testing import CliRunner

from rrmctl.cli.app import app
from rrmctl.errors import Exit
from rrmctl.running.pool import Pool
from rrmctl.store import load, planned
from rrmctl.store.layout import Layout
from rrmctl.store.reader import run_status
from rrmctl.store.records import State, read_status
from tests.rrmctl.running.standin import COMMAND, expected, prepare
from tests.rrmctl.running.test_pool import Record, rows

pytestmark = pytest.mark.slow

JOBS, STEPS, EVERY = 100, 400, 100  # of two milliseconds each


def endlessly(action: Callable[[], object], stop: threading.Event, errors: list[BaseException]) -> threading.Thread:
    """Repeat the action in a thread until told to stop; it ends with the first error."""

    def repeat() -> None:
        try:
            while not stop.is_set():
                action()
                time.sleep(0.05)
        except BaseException as error:
            errors.append(error)

    thread = threading.Thread(target=repeat)
    thread.start()
    return thread


def test_a_hundred_jobs_survive_a_storm(tmp_path: Path) -> None:
    """All end, none twice, every row is there, and whoever reads meanwhile sees no error."""
    layout, assigned = prepare(tmp_path, range(JOBS), STEPS, EVERY)
    rng, killed = random.Random(0), 0

    def kill_one() -> None:
        nonlocal killed
        time.sleep(1.0)
        states = [run_status(layout.run(job.id)) for job in assigned]
        if pids := [each.pid for each in states if each.state is State.RUNNING and each.pid is not None]:
            os.kill(rng.choice(pids), signal.SIGKILL)
            killed += 1

    def read_as_a_notebook_does() -> None:
        load(tmp_path, "stand-in")
        planned(tmp_path, "stand-in")
        for path in tmp_path.glob("runs/*/curve.parquet"):
            pd.read_parquet(path)

    def read_as_people_do() -> None:
        for command in (["status"], ["status", "--json"], ["report", "iqm", "--replicates", "100"]):
            result = CliRunner().invoke(app, [*command, "--results", str(tmp_path)])
            nothing_yet = result.exit_code == 2 and "no run can be reported yet" in result.stderr
            assert result.exit_code == 0 or nothing_yet, result.output

    stop, errors = threading.Event(), list[BaseException]()
    actions = (kill_one, read_as_a_notebook_does, read_as_people_do)
    threads = [endlessly(action, stop, errors) for action in actions]
    try:
        code = Pool(layout=layout, assignments=assigned, slots=20, watcher=Record(), retries=10, command=COMMAND).run()
    finally:
        stop.set()
        for thread in threads:
            thread.join()
    assert errors == []
    assert code is Exit.DONE
    assert rows(tmp_path) == expected(range(JOBS), STEPS, EVERY)
    assert killed > 5
    attempts = 0
    for job in assigned:
        folder = Layout(tmp_path).run(job.id)
        assert len(re.findall(r"^--- done at step", folder.log.read_text(), re.MULTILINE)) == 1
        attempts += read_status(folder).attempt
    assert JOBS <= attempts <= JOBS + killed
