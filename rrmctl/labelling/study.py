"""A study on the disk: which runs it has, what they have published, and where the answers are kept."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rrm.errors import LabelError
from rrm.files import make_folder
from rrm.teachers.labels import PRACTICE, SHARED, Label, read_labels, write_labels
from rrm.teachers.published import PublishedSession, published_steps, read_session, session_path
from rrmctl.commands import rrmctl
from rrmctl.errors import UserError
from rrmctl.labels import HUMAN
from rrmctl.store.files import storage_error
from rrmctl.store.layout import never_run
from rrmctl.store.status import RunState, statuses
from rrmctl.store.sweeps import readable_sweeps

if TYPE_CHECKING:
    from rrmctl.store.layout import Layout
    from rrmctl.store.status import Status
    from rrmctl.store.sweeps import Job

#: Where in the folder of what no run asks either kind stands, as a session before this step.
EXTRA = {PRACTICE: 0, SHARED: 1}


class Study:
    """The runs of an experiment that people teach."""

    def __init__(self, layout: Layout, experiment: str) -> None:
        """Raises UserError where the store holds no such run."""
        self.layout, self.experiment = layout, experiment
        self.damage: dict[Path, str] = {}  #: published files that cannot be read, and why
        self._known: dict[Path, tuple[tuple[int, int], PublishedSession]] = {}
        self.jobs: dict[str, Job] = {}
        self.look()
        if not self.jobs:
            raise UserError(
                f'no run of "{experiment}" in {layout.root} is taught by people',
                'name an experiment with teacher = "human", such as human-study',
            )

    def look(self) -> None:
        """See which runs were asked for by now. Raises UserError where the experiment never ran here."""
        sweeps, _ = readable_sweeps(self.layout, self.experiment)
        if not sweeps:
            raise never_run(self.layout, self.experiment)
        self.jobs = {job.id: job for sweep in sweeps for job in sweep.jobs if job.teacher == HUMAN}

    @property
    def tasks(self) -> list[str]:
        """Tasks of the runs."""
        return sorted({job.task for job in self.jobs.values()})

    def states(self) -> dict[str, Status]:
        """Where each run stands now."""
        return statuses(self.layout, self.jobs.values())

    def published(self) -> Iterator[tuple[Path, PublishedSession]]:
        """What the runs have put before people so far, with its file; a damaged one is noted in `damage`."""
        for run in self.jobs:
            folder = self.layout.run(run).path
            for path in (session_path(folder, step) for step in published_steps(folder)):
                if session := self._session(path):
                    yield path, session

    def of_nobody(self, task: str, purpose: str) -> tuple[Path, PublishedSession | None]:
        """What everybody is asked on a task, as far as it is there."""
        path = session_path(self.layout.extra_queries(task), EXTRA[purpose])
        return path, self._session(path)

    def _session(self, path: Path) -> PublishedSession | None:
        with contextlib.suppress(FileNotFoundError):  # a run that is trained anew
            stat = path.stat()
            mark = (stat.st_mtime_ns, stat.st_size)
            try:
                if path not in self._known or self._known[path][0] != mark:
                    self._known[path] = (mark, read_session(path))
                return self._known[path][1]
            except (LabelError, OSError) as error:
                self.damage[path] = str(error)
        return None

    def rows(self) -> Iterator[Label]:
        """Every answer so far. Raises LabelError where a file of them is damaged."""
        for run in ("", *self.jobs):
            yield from read_labels(self._labels(run))

    def write(self, run: str, rows: Sequence[Label]) -> None:
        """Replace the answers of a run ("": of none), durably. Raises StorageError where that cannot be."""
        path = self._labels(run)
        try:
            make_folder(path.parent)
            write_labels(path, rows)
        except OSError as error:
            raise storage_error(path, error) from error

    def _labels(self, run: str) -> Path:
        return self.layout.run(run).labels if run else self.layout.extra_labels

    def minutes(self, states: dict[str, Status]) -> float | None:
        """Until the next questions, at the speed of now; None where nothing tells."""
        left = []
        for run, status in states.items():
            steps = published_steps(self.layout.run(run).path)
            if status.state is RunState.RUNNING and len(steps) > 1 and status.steps_per_s:
                after = 2 * steps[-1] - steps[-2] - status.step
                left.append(max(0.0, after / status.steps_per_s / 60))
        return min(left, default=None)

    @property
    def command(self) -> str:
        """What serves it."""
        return rrmctl("label", self.experiment, results=self.layout.root)
