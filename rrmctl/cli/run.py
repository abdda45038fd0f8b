"""Commands that run: `run` and `resume`."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterable, Mapping
from dataclasses import fields
from functools import partial
from typing import TYPE_CHECKING, Annotated

import typer

from rrmctl.cli.introduction import LARGE_H, from_nothing, introduce
from rrmctl.cli.options import (
    DEFAULT_RESULTS,
    HANG_AFTER_MIN,
    AgainstOption,
    ExperimentArgument,
    ExperimentsOption,
    GroupOption,
    HangOption,
    MaxSeedsOption,
    MemoryOption,
    MethodsOption,
    PriorOption,
    ProfileOption,
    ResultsOption,
    RetryOption,
    SeedsOption,
    SetOption,
    TasksOption,
    UntilDecidedOption,
    WorkersOption,
)
from rrmctl.cli.progress import runs
from rrmctl.cli.request import Request, forecast
from rrmctl.cli.rerun import remaking_commands, unconfigured
from rrmctl.cli.screen import drain, unfailing
from rrmctl.cli.status import note_damage
from rrmctl.cli.stop_signals import resumable
from rrmctl.cli.summary import finish
from rrmctl.cli.trust import remember, require_trust
from rrmctl.commands import rrmctl
from rrmctl.errors import Exit, UserError
from rrmctl.terminal import console

if TYPE_CHECKING:
    from rich.console import Console

    from rrmctl.planning.plan import Plan
    from rrmctl.running.supervisor import Terms
    from rrmctl.store.layout import Layout
    from rrmctl.store.status import Status
    from rrmctl.store.sweeps import Job, SweepRecord


@resumable
def run(
    name: ExperimentArgument,
    seeds: SeedsOption = None,
    tasks: TasksOption = None,
    methods: MethodsOption = None,
    profile: ProfileOption = None,
    overrides: SetOption = None,
    prior: PriorOption = None,
    workers: WorkersOption = None,
    memory: MemoryOption = None,
    hang_after: HangOption = HANG_AFTER_MIN,
    results: ResultsOption = DEFAULT_RESULTS,
    experiments: ExperimentsOption = None,
    retry_failed: RetryOption = False,
    force: Annotated[
        bool, typer.Option("--force", help="Train the named runs again from nothing; what they hold is removed.")
    ] = False,
    yes: Annotated[bool, typer.Option("--yes", "-y", help="Do not ask before a large sweep.")] = False,
    until: UntilDecidedOption = False,
    max_seeds: MaxSeedsOption = None,
    group: GroupOption = None,
    against: AgainstOption = None,
) -> None:
    """Run an experiment, or go on with it: runs that are done are skipped, interrupted ones continue.

    Ctrl-C once lets every job write a checkpoint and leave; twice ends them at once. Any number of `run`s may share a
    results folder: they divide the jobs between them.

    With --until-decided every method is compared with one of them on every task, by its seeds' mean scores over
    training, after each group of seeds; what is decided runs no further seeds. The probability of any wrong decision is
    at most 5 % over all comparisons and looks, for rules that are fixed at the first call.

    Examples:

      rrmctl run quickstart

      rrmctl run main-results --seeds 10 --profile laptop

      rrmctl run main-results --tasks button-press --methods pebble,rrm-proxy --seeds 0,3,7 --workers 2

      rrmctl run toy-car --set agent.batch=256 --prior my_priors.py:closer

      rrmctl run toy-car --until-decided --max-seeds 20 --against pebble
    """
    from rrmctl.cli.until_decided import asked_rules, until_decided
    from rrmctl.running.supervisor import Terms
    from rrmctl.store.layout import new_results
    from rrmctl.store.status import statuses
    from rrmctl.store.sweeps import readable_sweeps

    screen = console(unfailing(sys.stderr))
    rules = asked_rules(until, max_seeds, group, against, other=seeds is not None or force)
    seeds = str(rules.most) if rules else seeds
    request = Request(name, experiments, profile, seeds, tasks, methods, overrides, prior)
    layout = new_results(results)
    plan = request.plan()
    note_damage(readable_sweeps(layout)[1])
    slots = workers or _default_slots(config.threads for config in plan.configs.values())
    expected = forecast(plan, layout)
    introduce(screen, request, from_nothing(expected) if force else expected, slots)
    if rules:
        screen.print(f"  note: at most; what is decided after a group of {rules.group} seeds runs no more of them")
    anew = {job.id for job in plan.jobs} if force else set()

    def wanted(job: Job, status: Status) -> bool:
        return job.id in anew or _is_open(status, retry_failed=retry_failed)

    def execute(part: Plan) -> tuple[Exit, SweepRecord]:
        sweep, states = _record(screen, layout, part), statuses(layout, part.everything)
        assigned = {
            job: Terms(threads=part.configs[job.id].threads, attempt=states[job.id].attempt, fresh=job.id in anew)
            for job in part.everything
            if wanted(job, states[job.id])
        }
        return _run(screen, layout, assigned, slots, memory, hang_after), sweep

    drain(screen.file)
    large = expected.hours_left > LARGE_H and any(wanted(job, expected.states[job.id]) for job in plan.everything)
    if large and not yes and _asks() and not typer.confirm("Start?", err=True):
        raise typer.Exit(Exit.INCOMPLETE)
    code, sweep = until_decided(layout, plan, rules, execute) if rules else execute(plan)
    drain(screen.file)
    finish(layout, code, [sweep], closing=plan.manifest.closing)


@resumable
def resume(
    name: Annotated[
        str | None, typer.Argument(metavar="[NAME]", help="Only this experiment. Default: all in the results folder.")
    ] = None,
    workers: WorkersOption = None,
    memory: MemoryOption = None,
    hang_after: HangOption = HANG_AFTER_MIN,
    results: ResultsOption = DEFAULT_RESULTS,
    retry_failed: RetryOption = False,
    trust: Annotated[
        bool, typer.Option("--trust", help="Run also code that the folder names and that you have not run from here.")
    ] = False,
) -> None:
    """Go on with every sweep that was begun in the results folder and is not complete.

    The configurations recorded then are run, whatever the manifests say today.
    """
    from rrmctl.running.supervisor import Terms
    from rrmctl.store.layout import open_results
    from rrmctl.store.status import statuses
    from rrmctl.store.sweeps import find_sweeps, readable_sweeps

    screen = console(unfailing(sys.stderr))
    layout = open_results(results)
    sweeps, damage = readable_sweeps(layout) if name is None else (find_sweeps(layout, name), [])
    note_damage(damage)
    if not sweeps:
        begin = rrmctl("run", "quickstart", results=results)
        raise UserError(f"{results} holds no sweep", f"begin one, such as `{begin}`; `rrmctl list` shows the names")
    jobs = {job.id: job for sweep in sweeps for job in sweep.everything}
    states = statuses(layout, jobs.values())
    chosen = [job for job in jobs.values() if _is_open(states[job.id], retry_failed=retry_failed)]
    for sweep in sweeps:
        count = sum(_is_open(states[job.id], retry_failed=retry_failed) for job in sweep.everything)
        total = runs(len(sweep.everything))
        screen.print(f"{sweep.experiment} ({sweep.variant}): {count} of {total} to go", soft_wrap=True)
    gone = unconfigured(layout, chosen)
    for command in remaking_commands(layout, sweeps, gone, states):
        screen.print(f"configurations are missing; this makes them, and the runs: {command}", soft_wrap=True)
    assigned = {
        job: Terms(threads=_threads(layout, job), attempt=states[job.id].attempt)
        for job in chosen
        if job.id not in gone
    }
    require_trust(results, _code(layout, chosen), trust=trust, asks=_asks())
    slots = workers or _default_slots(terms.threads for terms in assigned.values())
    code = _run(screen, layout, assigned, slots, memory, hang_after)
    drain(screen.file)
    finish(layout, code, sweeps, damaged=bool(damage or gone))


def _default_slots(threads: Iterable[int]) -> int:
    """As many jobs at a time as the cores allow when each keeps its threads busy."""
    from rrmctl.hardware import usable_cores

    return max(1, usable_cores() // max(threads, default=1))


def _is_open(status: Status, *, retry_failed: bool) -> bool:
    """True for a run that is to be worked on. One that is running elsewhere is: it may be given up there."""
    return status.state != "done" and (status.state not in ("failed", "blocked") or retry_failed)


def _record(console: Console, layout: Layout, plan: Plan) -> SweepRecord:
    """Write down what was asked for, and return it: first every run's configuration, then the sweep that names them."""
    from rrmctl.store.sweeps import SweepRecord, read_sweep, record_sweep, set_damaged_aside

    path = layout.sweep(plan.experiment, plan.variant)
    damage = set_damaged_aside(layout, path)  # one of another version is refused before anything is written
    known = read_sweep(path)
    asked = SweepRecord(**{field.name: getattr(plan, field.name) for field in fields(SweepRecord)})
    notes = [damage, *_configure(layout, plan, plan.everything)]
    late = set(record_sweep(layout, asked).superseded) - set(known.superseded if known else ())
    if late:
        told = f"{runs(len(late))} of other settings, files or versions gave way to what is asked for now"
        notes.append(f"{told}; `rrmctl clean` lists what nothing asks for any more")
    # Until the record named them, a `clean` may have removed some.
    notes += _configure(layout, plan, (job for job in plan.everything if not layout.run(job.id).config.exists()))
    for note in filter(None, notes):
        console.print(f"note: {note}", soft_wrap=True)
    return asked


def _configure(layout: Layout, plan: Plan, jobs: Iterable[Job]) -> list[str | None]:
    from rrmctl.running.config_file import code_files, config_content
    from rrmctl.store.provenance import record_config

    contents = {job.id: config_content(plan.configs[job.id]) for job in jobs}
    remember(digest for content in contents.values() for digest in code_files(content).values())
    return [record_config(layout.run(run), content) for run, content in contents.items()]


def _code(layout: Layout, jobs: Iterable[Job]) -> dict[str, str]:
    """Digests of the code of users that these runs name, by path."""
    from rrmctl.running.config_file import code_files
    from rrmctl.store.provenance import read_config

    found: dict[str, str] = {}
    for job in jobs:
        with contextlib.suppress(UserError):  # its worker refuses it
            found |= code_files(read_config(layout.run(job.id)))
    return found


def _threads(layout: Layout, job: Job) -> int:
    from rrmctl.store.provenance import read_config

    try:
        return int(read_config(layout.run(job.id))["threads"])
    except UserError:  # the run's own worker refuses it with this message, and the other runs go on
        return 1


def _run(
    console: Console,
    layout: Layout,
    assigned: Mapping[Job, Terms],
    slots: int,
    memory_gib: float | None,
    hang_after_min: float,
) -> Exit:
    """Run the jobs, shown as bars at a terminal and as lines elsewhere."""
    from rrmctl.cli.live import Bars, Lines
    from rrmctl.running.local import LocalExecutor
    from rrmctl.running.supervisor import Supervisor

    if not assigned:
        return Exit.DONE
    executor = LocalExecutor(
        layout=layout,
        memory_limit=None if memory_gib is None else int(memory_gib * 2**30),
        hang_after_s=hang_after_min * 60.0,
    )
    jobs, terms = list(assigned), {job.id: terms for job, terms in assigned.items()}
    pool = partial(
        Supervisor, layout=layout, jobs=jobs, terms=terms, slots=slots, executor=executor,
        asked=["rrmctl", *sys.argv[1:]],
    )  # fmt: skip
    if not sys.stderr.isatty() or console.is_dumb_terminal:
        return pool(watcher=Lines(console, layout, jobs)).run()
    bars = Bars(console, layout, jobs)
    with bars.progress:
        return pool(watcher=bars).run()


def _asks() -> bool:
    """Whether there is a person to ask."""
    return sys.stdin.isatty() and sys.stderr.isatty()
