"""What Slurm is asked: which runs of a results folder are queued or run, and where; to take job arrays, and drop tasks.

Nothing else is known by it. What a run is and whether it is done, the results folder says; whose it is, its lease.
"""

from __future__ import annotations

import dataclasses
import os
import subprocess
import time
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from pydantic import ConfigDict, StrictStr

from rrm.environ import environment
from rrmctl.errors import UserError
from rrmctl.running.supervisor import Terms
from rrmctl.store.files import is_locked
from rrmctl.store.layout import Layout
from rrmctl.store.owner import read_beat
from rrmctl.store.records import RunId, read_record, write_json
from rrmctl.store.schema import SCHEMA_VERSION

#: How long a program of Slurm's may take, seconds.
_PATIENCE_S = 60.0

#: Silence after which a run that no task runs looks lost, seconds: that of several signs of life.
SILENCE_S = 10.0

#: What `squeue` prints of a task: the array's name and number, the task's index, its state, why it waits, its node.
_FORMAT = "%j|%F|%K|%T|%r|%N"


class SlurmError(UserError):
    """Slurm is not here, or did not do what it was asked."""


@dataclass(frozen=True, kw_only=True)
class Submission:
    """A job array as `slurm/<name>.json` records it; Slurm knows it by its name, from the moment it takes it."""

    __pydantic_config__ = ConfigDict(extra="forbid")

    name: StrictStr
    tasks: tuple[dict[RunId, Terms], ...]  #: the runs of each, and how each is to be run
    asked: tuple[StrictStr, ...]  #: the command, for the runs' provenance
    job: StrictStr | None = None  #: Slurm's number of it, once that is known


class Task(NamedTuple):
    """A task that is in the queue."""

    array: str  #: the array's number
    number: int  #: the task's, in the array
    state: str  #: as Slurm calls it: PENDING, RUNNING, COMPLETING ...
    reason: str  #: why it waits
    node: str

    @property
    def id(self) -> str:
        """As Slurm's programs take it."""
        return f"{self.array}_{self.number}"

    @property
    def pending(self) -> bool:
        """It has no node yet."""
        return self.state == "PENDING"


class RefusedError(SlurmError):
    """It did nothing of what it was asked."""


#: What scancel says of tasks that ended before it came to them.
_OVER = ("Invalid job id specified", "already completing or completed")


def ask(*words: str, but: Sequence[str] = ()) -> str:
    """What a program of Slurm's prints. Raises SlurmError with its words where it fails; lines with one of `but` are no
    failure.
    """
    try:
        done = subprocess.run(
            words, env=environment(), stdin=subprocess.DEVNULL, capture_output=True, text=True, errors="replace",
            timeout=_PATIENCE_S, check=False,
        )  # fmt: skip
    except FileNotFoundError:
        hint = "a machine of the cluster has it, often one to log in to; `--executor local` runs here"
        raise RefusedError(f"there is no {words[0]} on this machine", hint) from None
    except subprocess.TimeoutExpired:
        raise SlurmError(f"{words[0]} gave no answer for {_PATIENCE_S:.0f} s", "try again later") from None
    complaints = (done.stderr or done.stdout).splitlines()
    serious = [line for line in complaints if not any(words in line for words in but)]
    if done.returncode and (serious or not complaints):
        said = " ".join(" ".join(serious).split()) or f"it left with {done.returncode}"
        # One that was killed may have been heard.
        raise (RefusedError if done.returncode > 0 else SlurmError)(f"{words[0]} refused: {said}")
    return done.stdout


def read_submission(layout: Layout, name: str) -> Submission | None:
    """The record of a job array; None where there is none. Raises DamagedError."""
    path = layout.submission(name)
    return read_record(Submission, path, f"remove it, and {path.with_suffix('.sh')}", "job")


def write_submission(layout: Layout, submission: Submission) -> None:
    """Replace the record of a job array."""
    content = {"schema_version": SCHEMA_VERSION, **dataclasses.asdict(submission)}
    write_json(layout.submission(submission.name), content)


def submissions(layout: Layout) -> dict[str, Submission]:
    """All job arrays that were submitted, by name. Raises DamagedError."""
    read = {name: read_submission(layout, name) for name in layout.submissions()}
    return {name: submission for name, submission in read.items() if submission is not None}


def read_queue(submitted: Mapping[str, Submission], among: Collection[str]) -> dict[str, Task]:
    """The task of each run among these that is queued or runs in an array of this user's. Raises SlurmError.

    One `squeue`, and none where no such run was ever submitted.
    """
    if not any(run in among for submission in submitted.values() for task in submission.tasks for run in task):
        return {}
    tasks = parse_queue(ask("squeue", "-h", "-r", f"--user={os.getuid()}", "-o", _FORMAT), submitted)
    return {run: task for run, task in tasks.items() if run in among}


def parse_queue(printed: str, submitted: Mapping[str, Submission]) -> dict[str, Task]:
    """What `squeue` has printed, by run; jobs that are not ours are left out."""
    tasks: dict[str, Task] = {}
    for line in printed.splitlines():
        name, *facts = line.split("|")
        if name in submitted and len(facts) == _FORMAT.count("|"):
            array, number, state, reason, node = facts
            task = Task(array, int(number), state, reason, node)
            tasks |= dict.fromkeys(submitted[name].tasks[task.number], task)
    return tasks


def lost(layout: Layout, suspects: Iterable[str], silence_s: float = SILENCE_S) -> set[str]:
    """Of runs that say that they are running, and that no task runs, those that give no sign of life so long."""
    silent = {run: read_beat(layout.run(run)) for run in suspects if not is_locked(layout.run(run).lock)}
    deadline = time.monotonic() + silence_s
    while silent and time.monotonic() < deadline:
        time.sleep(min(0.5, silence_s))
        silent = {run: beat for run, beat in silent.items() if read_beat(layout.run(run)) == beat}
    return set(silent)


def cancel(tasks: Collection[Task]) -> None:
    """Take tasks that have no node yet out of the queue; those that got one meanwhile stay."""
    if tasks:
        ask("scancel", "--state=PENDING", *sorted({task.id for task in tasks}), but=_OVER)


def interrupt(tasks: Collection[Task]) -> None:
    """Ask tasks that run to have their runs checkpointed and leave; they stay away."""
    if tasks:
        ask("scancel", "--signal=INT", "--batch", *sorted({task.id for task in tasks}), but=_OVER)
