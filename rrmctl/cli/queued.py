"""What `status` says of a store's job arrays: which runs are queued and why, which run where, which are lost."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from rrmctl.cli.progress import runs
from rrmctl.errors import UserError

if TYPE_CHECKING:
    from rrmctl.running.slurm import Task
    from rrmctl.store.layout import Layout
    from rrmctl.store.status import Status


@dataclass(frozen=True)
class Queued:
    """One look at the queue."""

    tasks: Mapping[str, Task] = field(default_factory=dict)  #: by run
    lost: Mapping[str, str] = field(default_factory=dict)  #: runs that say that they run, by the machine they name
    problem: UserError | None = None  #: why the queue is not known

    def lines(self, command: Callable[..., str]) -> Iterator[str]:
        """For people."""
        if self.problem is not None:
            yield f"note: what is queued or lost is not known: {self.problem}"
        if waiting := self._grouped(pending=True):
            reasons = ", ".join(f"{reason} {len(names)}" for reason, names in waiting.items())
            yield f"Slurm: {self._counted(waiting)} queued ({reasons})"
        if active := self._grouped(pending=False):
            yield f"Slurm: {self._counted(active)} running on {', '.join(active)}"
        if self.lost:
            where = ", ".join(sorted(set(self.lost.values())))
            yield (
                f"Lost: {runs(len(self.lost))}, last on {where}: neither a task nor a sign of life is there; "
                f"this goes on: {command('resume', '--executor', 'slurm')}"
            )

    def as_json(self) -> dict[str, Any]:
        """For programs."""
        return {
            "queued": self._grouped(pending=True), "running": self._grouped(pending=False),
            "lost": sorted(self.lost), "note": self.problem and str(self.problem),
        }  # fmt: skip

    @staticmethod
    def _counted(grouped: Mapping[str, list[str]]) -> str:
        return f"tasks of {runs(sum(map(len, grouped.values())))}"

    def _grouped(self, *, pending: bool) -> dict[str, list[str]]:
        """Runs by the reason why they wait, or by their node."""
        grouped = defaultdict[str, list[str]](list)
        for run, task in sorted(self.tasks.items()):
            if task.pending is pending:
                grouped[task.reason if pending else task.node].append(run)
        return dict(sorted(grouped.items()))


def look(layout: Layout, states: Mapping[str, Status]) -> Queued:
    """Ask Slurm once, if something that was submitted from this store is not done."""
    from rrmctl.running.slurm import lost, read_queue, submissions

    try:
        submitted = submissions(layout)
        of_slurm = {run for submission in submitted.values() for task in submission.tasks for run in task}
        left = {run for run in of_slurm & states.keys() if states[run].state != "done"}
        tasks = read_queue(submitted, left)
    except UserError as error:
        return Queued(problem=error)
    suspects = {run for run in left - tasks.keys() if states[run].state == "running"}
    return Queued(tasks, {run: states[run].host or "?" for run in lost(layout, suspects)})
