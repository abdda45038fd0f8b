"""A task of a job array: sees its runs to their end, or to a checkpoint when Slurm or its user wants the node back.

    python -P -m rrmctl.running.slurm_task RESULTS NAME

Slurm says so with USR1 some time before its time is over, and with TERM where it preempts: the task is queued again.
Its user says so with `scancel` (TERM) or `rrmctl stop` (INT): it stays away.
"""

from __future__ import annotations

import argparse
import os
import re
import signal
import socket
import sys
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rrmctl.errors import Exit

if TYPE_CHECKING:
    from rrmctl.running.scheduler import Outcome, Stage
    from rrmctl.running.supervisor import Supervisor
    from rrmctl.store.labels import OpenSession
    from rrmctl.store.layout import Layout
    from rrmctl.store.sweeps import Job

#: How long workers have to checkpoint, seconds; a notice comes a minute earlier than that before the end.
_LEAVE_S = 240.0


def main(argv: Sequence[str] | None = None) -> Exit:
    """Do what the array's record names for this task."""
    signals: list[int] = []  # before anything heavy is imported: until then one of them ends the process
    for number in (signal.SIGUSR1, signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda number, _frame: signals.append(number))
    from rrmctl.errors import UserError
    from rrmctl.store.layout import Layout
    from rrmctl.terminal import attend

    attend()
    parser = argparse.ArgumentParser(prog="python -m rrmctl.running.slurm_task", description="A task of a job array.")
    parser.add_argument("results", type=Path)
    parser.add_argument("name")
    given = parser.parse_args(argv)
    task = "_".join(os.environ[f"SLURM_ARRAY_{part}_ID"] for part in ("JOB", "TASK"))
    _say(f"task {task} on {socket.gethostname()}, requeued {os.environ.get('SLURM_RESTART_COUNT', '0')} times")
    try:
        code = _perform(Layout(given.results), given.name, int(os.environ["SLURM_ARRAY_TASK_ID"]), signals)
        if code is Exit.INCOMPLETE and signals:
            _requeue(task, signals)
    except UserError as error:
        _say(f"error: {error}" + (f" ({error.hint})" if error.hint else ""))
        return error.code
    return code


def _perform(layout: Layout, name: str, index: int, signals: list[int]) -> Exit:
    from rrm.hardware import usable_cores
    from rrmctl.errors import UserError
    from rrmctl.running.local import LocalExecutor
    from rrmctl.running.slurm import read_submission
    from rrmctl.running.supervisor import Supervisor

    submission = read_submission(layout, name)
    if submission is None:
        raise UserError(f"there is no {layout.submission(name)}", "submit again what it named")
    terms = submission.tasks[index]
    jobs, code = _startable(layout, terms)
    if not jobs:
        return code
    cores = min(usable_cores(), int(os.environ.get("SLURM_CPUS_ON_NODE", "1")))
    log = _Log()
    log.supervisor = Supervisor(
        layout=layout, jobs=jobs, terms=terms, slots=max(1, cores // max(each.threads for each in terms.values())),
        watcher=log, executor=LocalExecutor(layout=layout), asked=submission.asked, signals=signals, patient=True,
        stop_after_s=_LEAVE_S,
    )  # fmt: skip
    return max(code, log.supervisor.run())


def _startable(layout: Layout, runs: Collection[str]) -> tuple[list[Job], Exit]:
    """Those of a task's runs whose requirements are met; the others are told of, with the exit code that they make."""
    from rrmctl.store.status import statuses
    from rrmctl.store.sweeps import readable_sweeps, required

    known = {job.id: job for sweep in readable_sweeps(layout)[0] for job in sweep.everything}
    jobs = [known[run] for run in runs if run in known]
    needed = required(jobs, known.values()) & known.keys()
    states = statuses(layout, [*jobs, *(known[run] for run in needed)])
    startable, code = [], Exit.DONE
    for job in jobs:
        missing = [run for run in job.requires if run in states and states[run].state != "done"]
        if states[job.id].state == "blocked":
            code = max(code, Exit.FAILED)
            _say(f"{job.id} {job.label}: not run: {states[job.id].error}")
        elif missing:
            code = Exit.INCOMPLETE
            _say(f"{job.id} {job.label}: not run: {missing[0]}, which it needs, is {states[missing[0]].state}")
        else:
            startable.append(job)
    return startable, code


def _requeue(task: str, signals: Collection[int]) -> None:
    """Have Slurm queue the task again, unless its user does not want it any more."""
    from rrmctl.running.slurm import SlurmError, ask

    for number in (signal.SIGUSR1, signal.SIGTERM, signal.SIGINT):
        signal.signal(number, signal.SIG_IGN)  # all is checkpointed, and the requeue itself sends TERM
    try:
        if goes_on(signals, ask("scontrol", "show", "job", task)):
            ask("scontrol", "requeue", task)
            _say("queued again")
    except SlurmError as error:
        _say(f"not queued again: {error}; `rrmctl resume --executor slurm` submits what is left")


def goes_on(signals: Collection[int], shown: str) -> bool:
    """Whether a task that was told to leave is to be queued again: not one that its user has cancelled or stopped.

    `shown` is what `scontrol show job` prints of it: after `scancel` it says COMPLETING.
    """
    state = re.search(r"\bJobState=(\w+)", shown)
    return signal.SIGINT not in signals and state is not None and state[1] in ("RUNNING", "SIGNALING")


class _Log:
    """Tells the task's log what becomes of its runs; each has a log of its own, which says more."""

    supervisor: Supervisor

    def started(self, job: str, attempt: int) -> None:
        _say(f"{job} started, attempt {attempt}")

    def beat(self, job: str, step: int, steps_per_s: float | None) -> None:
        """Nothing: the run's status tells."""

    def row(self, job: str, step: int, success: float | None, true_return: float | None) -> None:
        """Nothing: the run's curve tells."""

    def note(self, job: str, text: str) -> None:
        _say(f"{job} {text}")

    def ended(self, job: str, outcome: Outcome, phase: Stage) -> None:
        after = " and will be tried again" if outcome.ending == "failed" and phase == "waiting" else ""
        _say(f"{job} {outcome.ending}{after}" + (f": {outcome.error}" if outcome.error else ""))

    def stopping(self, workers: int, wait_s: float) -> None:
        told = ", ".join(signal.Signals(number).name for number in self.supervisor.signals)
        _say(f"{told}: {workers} running, checkpoints are written, in at most {wait_s:.0f} s")

    def asked(self, sessions: Sequence[OpenSession]) -> None:
        """A node is not kept until people have answered."""
        stages = self.supervisor.scheduler.counts().keys()
        if sessions and stages.isdisjoint({"running", "waiting"}):
            self.supervisor.scheduler.stop()

    def tick(self) -> None:
        """Nothing moves."""


def _say(text: str) -> None:
    from rrmctl.running.parent_link import say

    say(f"--- {text}")


if __name__ == "__main__":
    sys.exit(main())
