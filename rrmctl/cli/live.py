"""What a person sees of a sweep under way: a bar per running job at a terminal, plain lines anywhere else."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from functools import partial
from types import MappingProxyType

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TaskProgressColumn, TextColumn
from rich.text import Text

from rrmctl.cli import progress
from rrmctl.cli.request import duration
from rrmctl.running.scheduler import Outcome, Stage
from rrmctl.store.labels import OpenSession
from rrmctl.store.layout import Layout
from rrmctl.store.status import ErrorKind, log_tail
from rrmctl.store.sweeps import Job

#: Least time between two lines about the evaluations of one job, seconds.
_EVERY_S = 10.0
_NAMELESS: Mapping[str, str] = MappingProxyType({})
_OVER = (Stage.DONE, Stage.FAILED, Stage.BLOCKED)


class Lines:
    """Says every event worth keeping as one line on the console: started, evaluated, failed, done."""

    def __init__(
        self, console: Console, layout: Layout, jobs: Sequence[Job], experiment_of: Mapping[str, str] = _NAMELESS
    ) -> None:
        """Args: experiment_of: the experiment of each job."""
        self.console = console
        self.over = 0  #: jobs done or failed
        self.total = len(jobs)
        self._layout = layout
        self._jobs = {job.id: job for job in jobs}
        self._said: dict[str, float] = {}
        self._experiment_of = experiment_of
        self._open: set[tuple[str, int]] = set()  # runs and steps of the sessions that people were told of
        self._told = -_EVERY_S  # when that was

    def started(self, job: str, attempt: int) -> None:
        self.say(job, f"started, attempt {attempt}" if attempt > 1 else "started")

    def beat(self, job: str, step: int, steps_per_s: float | None) -> None:
        """Nothing: lines are for what lasts."""

    def row(self, job: str, step: int, success: float | None, true_return: float | None) -> None:
        if time.monotonic() - self._said.get(job, -_EVERY_S) >= _EVERY_S:
            self._said[job] = time.monotonic()
            self.say(job, f"step {step:,} of {self._jobs[job].steps:,}, {score(success, true_return)}")

    def note(self, job: str, text: str) -> None:
        self.say(job, text, style="yellow")

    def ended(self, job: str, outcome: Outcome, phase: Stage) -> None:
        if phase in _OVER:
            self.over += 1
        error, folder = outcome.error, self._layout.run(job)
        match outcome.ending:
            case Stage.DONE:
                self.say(job, f"done ({self.over} of {self.total})", style="green")
            case Stage.STOPPED:
                self.say(job, "stopped; it goes on from its checkpoint", style="yellow")
            case Stage.ELSEWHERE if error:
                self.say(job, f"waits for {error}", style="yellow")
            case Stage.ELSEWHERE:
                self.say(job, "is run by another process", style="dim")
            case Stage.BLOCKED:
                self.say(job, f"not run: {error}", style="red")
            case Stage.FAILED if error and error.kind is ErrorKind.WAITING:
                self.say(job, f"waits for {error}", style="yellow")
            case Stage.FAILED:
                after = {Stage.WAITING: "will be tried again", Stage.FAILED: "failed"}.get(phase, "stopped")
                self.say(job, f"{after}: {error}", style="red")
                if error and error.kind not in (ErrorKind.REFUSED, ErrorKind.STORAGE, ErrorKind.MISSING):
                    for line in (*log_tail(folder), f"log: {folder.log}"):  # else the message says it all
                        self.console.print(f"    {line}", style="dim", soft_wrap=True)

    def stopping(self, workers: int, wait_s: float) -> None:
        self.console.print(
            f"stopping: {workers} running {'jobs write' if workers != 1 else 'job writes'} a checkpoint, "
            f"in at most {wait_s:.0f} s; Ctrl-C again ends everything at once",
            style="yellow",
            soft_wrap=True,
        )

    def asked(self, sessions: Sequence[OpenSession]) -> None:
        now = {(session.run, session.step) for session in sessions}
        if now - self._open and time.monotonic() - self._told >= _EVERY_S:
            self._open, self._told = now, time.monotonic()
            for line in progress.awaited(sessions, self._experiment_of, self._layout.root):
                self.console.print(line, style="yellow", soft_wrap=True)

    def tick(self) -> None:
        """Nothing moves."""

    def say(self, job: str, text: str, style: str | None = None) -> None:
        line = Text.assemble((time.strftime("%H:%M:%S "), "dim"), (self._jobs[job].label, "bold"), ": ")
        self.console.print(line.append(text, style), soft_wrap=True)


class Bars(Lines):
    """Lines, and below them a bar for each running job and one for all."""

    def __init__(
        self, console: Console, layout: Layout, jobs: Sequence[Job], experiment_of: Mapping[str, str] = _NAMELESS
    ) -> None:
        super().__init__(console, layout, jobs, experiment_of)
        self.progress = Progress(
            TextColumn("{task.description}", markup=False),
            BarColumn(),
            TaskProgressColumn(),
            TextColumn("{task.fields[rate]}", justify="right"),
            TextColumn("{task.fields[score]}"),
            TextColumn("{task.fields[left]}", justify="right"),
            console=console,
            auto_refresh=False,  # the pool's ticks refresh it: no second thread beside the one that starts processes
            transient=True,
        )
        self._bars: dict[str, TaskID] = {}
        self._add = partial(self.progress.add_task, rate="", score="", left="")
        self._all = self._add("", total=self.total)
        self._steps_done = 0  # of finished jobs
        self._waiting = ""  # what people are asked, in words
        self._rates: dict[str, float] = {}

    def started(self, job: str, attempt: int) -> None:
        if attempt > 1:
            super().started(job, attempt)
        self._bars[job] = self._add(self._jobs[job].label, total=self._jobs[job].steps)

    def beat(self, job: str, step: int, steps_per_s: float | None) -> None:
        if steps_per_s:
            # Smoothed over a few seconds: single beats jump with every feedback session.
            self._rates[job] = 0.9 * self._rates.get(job, steps_per_s) + 0.1 * steps_per_s
        rate = self._rates.get(job, 0.0)
        left = duration((self._jobs[job].steps - step) / rate / 3600) if rate else ""
        self._update(job, completed=step, rate=f"{rate:,.0f} steps/s" if rate else "", left=left)

    def row(self, job: str, step: int, success: float | None, true_return: float | None) -> None:
        self._update(job, completed=step, score=score(success, true_return))

    def ended(self, job: str, outcome: Outcome, phase: Stage) -> None:
        super().ended(job, outcome, phase)
        if job in self._bars:
            self.progress.remove_task(self._bars.pop(job))
        self._rates.pop(job, None)
        if phase in _OVER:
            self._steps_done += self._jobs[job].steps

    def asked(self, sessions: Sequence[OpenSession]) -> None:
        super().asked(sessions)
        missing = sum(session.missing for session in sessions)
        self._waiting = f"; {len(sessions)} wait for {missing:,} answers" if sessions else ""

    def tick(self) -> None:
        left, speed = "", sum(self._rates.values())
        if speed:  # that of the jobs that run now
            running = sum(task.completed for task in self.progress.tasks if task.id != self._all)
            steps = sum(job.steps for job in self._jobs.values()) - self._steps_done - running
            left = duration(steps / speed / 3600)
        description = f"{self.over} of {self.total} runs{self._waiting}"
        self.progress.update(self._all, description=description, completed=self.over, left=left)
        self.progress.refresh()

    def _update(self, job: str, **fields: object) -> None:
        if job in self._bars:
            self.progress.update(self._bars[job], **fields)  # type: ignore[arg-type]


def score(success: float | None, true_return: float | None) -> str:
    """The last evaluation in words: the share of successes, or the return of tasks without that notion."""
    if success is not None:
        return f"success {success:.0%}"
    return "" if true_return is None else f"return {true_return:,.1f}"
