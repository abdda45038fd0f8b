"""Kills a worker, and the program itself, at each file operation in turn, and lets another go on.

    python -m tests.rrmctl.running.moments worker|command ROOT STRIDE

Every attempt is a process of its own, forked from this one so that nothing is imported twice. Python tells its audit
hooks of a file operation just before it happens; there the process is killed. Prints what was found as JSON.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import random
import shutil
import signal
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd
from typer.testing import CliRunner

from rrm.training import jobs
from rrmctl.cli.app import app
from rrmctl.errors import Exit
from rrmctl.running.worker import WorkerExit, main
from rrmctl.store.layout import RunFolder
from tests.rrmctl.running.test_torn import numbers, prepared, work

#: Of workers, at least.
KILLS = 200

_WRITES = os.O_WRONLY | os.O_RDWR | os.O_CREAT
_OPERATIONS = {"os.rename", "os.link", "os.remove", "os.mkdir", "os.rmdir", "os.truncate", "fcntl.flock"}


@dataclass
class Found:
    """What became of the runs."""

    kills: int = 0
    unfinished: list[int] = field(default_factory=list)  #: operations after whose interruption the run did not end
    different: list[int] = field(default_factory=list)  #: ... or ended otherwise than undisturbed
    twice: list[int] = field(default_factory=list)  #: ... or was trained to its end twice


def forked(action: Callable[[], int], output: Path, kill_at: int | None = None) -> int:
    """The exit code of a process that does this; it is killed at its operation of this number, counted from 0."""
    child = os.fork()
    if child == 0:
        with output.open("ab") as file:
            os.dup2(file.fileno(), 1)
            os.dup2(file.fileno(), 2)
        if kill_at is not None:
            sys.addaudithook(_executioner(kill_at))
        os._exit(action())
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def attempt(folder: RunFolder, kill_at: int | None = None) -> int:
    """The exit code of one worker."""
    return forked(lambda: main([str(folder.path.parents[1]), folder.id], jobs), folder.path / "output", kill_at)


def _executioner(kill_at: int) -> Any:
    seen = itertools.count()

    def look(event: str, args: tuple[Any, ...]) -> None:
        writes = event in _OPERATIONS or (event == "open" and args[2] & _WRITES)
        if writes and next(seen) == kill_at:
            os.kill(os.getpid(), signal.SIGKILL)

    return look


def killed_at(root: Path, kill_at: int, undisturbed: tuple[str, str], found: Found) -> bool:
    """One run, killed once. False when it ended before that operation."""
    folder = prepared(root)
    if attempt(folder, kill_at) != -signal.SIGKILL:
        return False
    found.kills += 1
    if attempt(folder) != WorkerExit.DONE:
        found.unfinished.append(kill_at)
    else:
        judge(folder, kill_at, undisturbed, found)
    shutil.rmtree(root)
    return True


def killed_again_and_again(root: Path, seed: int, undisturbed: tuple[str, str], found: Found) -> None:
    """One run, killed at random operations until it ends for want of a further one."""
    rng, folder = random.Random(seed), prepared(root)
    while (code := attempt(folder, rng.randrange(20, 90))) == -signal.SIGKILL:
        found.kills += 1
    if code != WorkerExit.DONE:
        found.unfinished.append(-seed)
    else:
        judge(folder, -seed, undisturbed, found)


def judge(folder: RunFolder, name: int, undisturbed: tuple[str, str], found: Found) -> None:
    if numbers(folder) != undisturbed:
        found.different.append(name)
    if folder.path.joinpath("output").read_text().count("--- done at step") > 1:
        found.twice.append(name)


def examine(root: Path, stride: int) -> Found:
    folder = prepared(root / "undisturbed")
    with contextlib.redirect_stdout(sys.stderr):
        assert work(folder) == WorkerExit.DONE  # in this process, so that whatever an attempt imports is there
    while threading.active_count() > 1:
        time.sleep(0.1)  # only a process of one thread may be forked
    undisturbed, found = numbers(folder), Found()
    for kill_at in itertools.count(0, stride):
        if not killed_at(root / "killed", kill_at, undisturbed, found):
            break
    for seed in itertools.takewhile(lambda _: found.kills < KILLS, itertools.count(1)):
        killed_again_and_again(root / f"again-{seed}", seed, undisturbed, found)
    return found


def command(results: Path) -> int:
    """The exit code of `rrmctl run` on these results."""
    sweep = ("toy-car", "--profile", "smoke", "--seeds", "2", "--methods", "oracle")
    return CliRunner().invoke(app, ["run", *sweep, "--results", str(results)]).exit_code


def examine_command(root: Path, stride: int) -> Found:
    """The program killed while it records a sweep whose runs are done, and while it sums them up."""
    quiet, loud, output, found = root / "quiet", root / "loud", root / "output", Found()
    assert command(quiet) == Exit.DONE
    for kill_at in itertools.count(0, stride):
        shutil.copytree(quiet / "runs", loud / "runs", ignore=shutil.ignore_patterns("config.json"))
        if forked(lambda: command(loud), output, kill_at) != -signal.SIGKILL:
            return found
        found.kills += 1
        if forked(lambda: command(loud), output) != Exit.DONE:
            found.unfinished.append(kill_at)
        elif told(loud) != told(quiet):
            found.different.append(kill_at)
        shutil.rmtree(loud)
    raise AssertionError("unreachable")


def told(results: Path) -> dict[str, str]:
    """What the program writes itself: every configuration, the sweep and the aggregate."""
    texts = {str(path.relative_to(results)): path.read_text() for path in results.rglob("*/*.json")
             if path.name != "status.json"}  # fmt: skip
    return texts | {path.name: str(pd.read_parquet(path).to_dict()) for path in results.glob("aggregates/*.parquet")}


if __name__ == "__main__":
    what = {"worker": examine, "command": examine_command}[sys.argv[1]]
    sys.stdout.write(json.dumps(vars(what(Path(sys.argv[2]), int(sys.argv[3])))))
