"""Runs become Slurm's job arrays: one for each level of dependency and each kind of resources."""

from __future__ import annotations

import dataclasses
import re
import secrets
import shlex
import sys
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from graphlib import TopologicalSorter
from pathlib import Path
from typing import NamedTuple, TypeVar

from rrmctl.running.slurm import RefusedError, Submission, Task, ask, write_submission
from rrmctl.running.supervisor import Terms
from rrmctl.store.files import write_bytes
from rrmctl.store.layout import Layout
from rrmctl.store.sweeps import Job

_T = TypeVar("_T")

#: So long before its time is over a task is told, seconds.
NOTICE_S = 300


class Site(NamedTuple):
    """How a user submits: see docs/cluster.md."""

    flags: tuple[str, ...] = ()  #: of sbatch, as they stand
    setup: str = ""  #: lines of bash before Python starts
    at_once: int | None = None  #: tasks of an array that run at a time; None: as many as Slurm likes
    pack: int = 1  #: runs of a task


class Order(NamedTuple):
    """A run that is to be submitted."""

    job: Job
    terms: Terms
    experiment: str  #: whose array it joins
    gpu: bool = False


class Array(NamedTuple):
    """Runs that are alike in what they need, by task."""

    experiment: str
    threads: int
    gpu: bool
    tasks: tuple[tuple[Order, ...], ...]

    @property
    def runs(self) -> Iterator[Order]:
        """Of all tasks."""
        return (order for task in self.tasks for order in task)


def levels(requires: Mapping[str, Sequence[str]]) -> dict[str, int]:
    """For each run how many others of these must be done one after the other before it."""
    deep: dict[str, int] = {}
    for run in TopologicalSorter(requires).static_order():
        deep[run] = 1 + max((deep[needed] for needed in requires.get(run, ()) if needed in requires), default=-1)
    return {run: deep[run] for run in requires}


def arrays(orders: Sequence[Order], queued: Mapping[str, Sequence[str]], pack: int, largest: int) -> list[Array]:
    """The arrays that these runs become, in the order in which they are to be submitted.

    Args:
        queued: what each run requires that is under way already.
        pack: runs of a task.
        largest: tasks of an array.
    """
    deep = levels({**queued, **{order.job.id: order.job.requires for order in orders}})
    alike = defaultdict[tuple[int, str, int, bool], list[Order]](list)
    for order in orders:
        alike[deep[order.job.id], order.experiment, order.terms.threads, order.gpu].append(order)
    return [
        Array(experiment, threads, gpu, chunk)
        for (_, experiment, threads, gpu), group in sorted(alike.items(), key=lambda item: item[0])
        for chunk in _batched(_batched(group, pack), largest)
    ]


def _batched(items: Sequence[_T], size: int) -> list[tuple[_T, ...]]:
    return [tuple(items[at : at + size]) for at in range(0, len(items), size)]


def largest_array(config: str) -> int:
    """The most tasks of an array, by what `scontrol show config` prints; the index of the last is one less."""
    found = re.search(r"^MaxArraySize\s*=\s*(\d+)", config, re.MULTILINE)
    return max(1, int(found[1])) if found else 1


def sbatch(name: str, array: Array, site: Site, folder: Path, after: Sequence[str]) -> list[str]:
    """The command that submits an array, but for its script. The user's flags win over ours where they may."""
    at_once = f"%{site.at_once}" if site.at_once else ""
    return [
        "sbatch", "--requeue", "--open-mode=append", f"--signal=B:USR1@{NOTICE_S}", f"--cpus-per-task={array.threads}",
        *(["--gres=gpu:1"] if array.gpu else []), *site.flags, "--parsable", f"--job-name={name}",
        f"--array=0-{len(array.tasks) - 1}{at_once}", f"--output={str(folder).replace('%', '%%')}/%A_%a.log",
        *([f"--dependency=afterany:{':'.join(after)}"] if after else []),
    ]  # fmt: skip


def script(command: Sequence[str], setup: str, task: Sequence[str]) -> str:
    """The batch script. Python takes the shell's place: children of a shell would outlive its job."""
    said = shlex.join(command).replace("\n", " ")
    return "\n".join(["#!/bin/bash", f"# {said}", *filter(None, [setup]), f"exec {shlex.join(task)}", ""])


def submit(
    layout: Layout, orders: Sequence[Order], site: Site, *, queue: Mapping[str, Task],
    queued: Mapping[str, Sequence[str]], asked: Sequence[str], told: Callable[[Submission, Array], None],
) -> None:  # fmt: skip
    """Submit runs. Raises SlurmError where Slurm does not take an array; those before it stay.

    The record is written first: where this process dies before it knows the array's number, the name finds it.

    Args:
        queue: tasks that are in the queue, by run.
        queued: as in `arrays`.
        told: is given each array that Slurm has taken.
    """
    if not orders:
        return
    folder = layout.slurm.absolute()
    array_of = {run: task.array for run, task in queue.items()}
    for array in arrays(orders, queued, site.pack, largest_array(ask("scontrol", "show", "config"))):
        name = f"{array.experiment[:100]}-{secrets.token_hex(4)}"
        record = layout.submission(name)
        after = {array_of[run] for order in array.runs for run in order.job.requires if run in array_of}
        command = sbatch(name, array, site, folder, sorted(after))
        words = [sys.executable, "-P", "-m", "rrmctl.running.slurm_task", str(folder.parent), name]
        tasks = tuple({order.job.id: order.terms for order in task} for task in array.tasks)
        submission = Submission(name=name, tasks=tasks, asked=tuple(asked))
        write_bytes(record.with_suffix(".sh"), script(command, site.setup, words).encode())
        write_submission(layout, submission)
        try:
            number = ask(*command, str(folder / f"{name}.sh")).strip().partition(";")[0]
        except RefusedError:
            for path in (record, record.with_suffix(".sh")):
                path.unlink()
            raise
        submission = dataclasses.replace(submission, job=number)
        write_submission(layout, submission)
        array_of |= {order.job.id: number for order in array.runs}
        told(submission, array)
