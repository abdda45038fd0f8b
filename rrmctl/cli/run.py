"""Commands that run: `run` and `resume`."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterable, Mapping
from dataclasses import fields, replace
from typing import TYPE_CHECKING, Annotated

import typer

from rrm.hardware import usable_cores
from rrmctl.cli import options
from rrmctl.cli.progress import runs
from rrmctl.cli.request import LARGE_H, Request, forecast, introduce
from rrmctl.cli.screen import drain, unfailing
from rrmctl.cli.status import note_damage
from rrmctl.cli.stop_signals import resumable
from rrmctl.cli.summary import finish, remaking_commands, unconfigured
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


@resumable()
def run(
    name: options.ExperimentArgument,
    seeds: options.SeedsOption = None,
    tasks: options.TasksOption = None,
    methods: options.MethodsOption = None,
    profile: options.ScaleOption = None,
    overrides: options.SetOption = None,
    prior: options.PriorOption = None,
    workers: options.WorkersOption = None,
    memory: options.MemoryOption = None,
    hang_after: options.HangOption = options.HANG_AFTER_MIN,
    results: options.ResultsOption = options.DEFAULT_RESULTS,
    experiments: options.ExperimentsOption = None,
    retry_failed: options.RetryOption = False,
    force: Annotated[
        bool, typer.Option("--force", help="Train the named runs again from nothing; what they hold is removed.")
    ] = False,
    yes: Annotated[bool, typer.Option("--yes", "-y", help="Do not ask before a large sweep.")] = False,
    until: options.UntilDecidedOption = False,
    max_seeds: options.MaxSeedsOption = None,
    group: options.GroupOption = None,
    against: options.AgainstOption = None,
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
    from rrmctl.store.status import Status, statuses
    from rrmctl.store.sweeps import readable_sweeps

    screen = console(unfailing(sys.stderr))
    rules = asked_rules(until, max_seeds, group, against, other=seeds is not None or force)
    seeds = str(rules.most) if rules else seeds
    request = Request(name, experiments, profile, seeds, tasks, methods, overrides, prior)
    layout = new_results(results)
    plan = request.plan()
    note_damage(readable_sweeps(layout)[1])
    slots = workers or _slots(config.threads for config in plan.configs.values())
    expected = forecast(plan, layout)
    anew = {job.id for job in plan.jobs} if force else set()
    before = replace(expected, states=dict.fromkeys(expected.states, Status())) if force else expected
    introduce(screen, request, before, slots)
    if rules:
        screen.print(f"  note: at most; what is decided after a group of {rules.group} seeds runs no more of them")

    def wanted(job: Job, status: Status) -> bool:
        return job.id in anew or _is_open(status, retry_failed=retry_failed)

    _require_opengl(
        plan.configs[job.id].needs_opengl for job in plan.everything if wanted(job, expected.states[job.id])
    )

    def execute(part: Plan) -> tuple[Exit, SweepRecord]:
        sweep, states = _record(screen, layout, part), statuses(layout, part.everything)
        assigned = {
            job: Terms(threads=part.configs[job.id].threads, attempt=states[job.id].attempt, fresh=job.id in anew)
            for job in part.everything
            if wanted(job, states[job.id])
        }
        return _train(screen, layout, assigned, slots, memory, hang_after), sweep

    drain(screen.file)
    large = expected.hours_left > LARGE_H and any(wanted(job, expected.states[job.id]) for job in plan.everything)
    if large and not yes and _asks() and not typer.confirm("Start?", err=True):
        raise typer.Exit(Exit.INCOMPLETE)
    code, sweep = until_decided(layout, plan, rules, execute) if rules else execute(plan)
    drain(screen.file)
    finish(layout, code, [sweep], closing=plan.manifest.closing)


@resumable()
def resume(
    name: Annotated[
        str | None, typer.Argument(metavar="[NAME]", help="Only this experiment. Default: all in the results folder.")
    ] = None,
    workers: options.WorkersOption = None,
    memory: options.MemoryOption = None,
    hang_after: options.HangOption = options.HANG_AFTER_MIN,
    results: options.ResultsOption = options.DEFAULT_RESULTS,
    retry_failed: options.RetryOption = False,
    trust: Annotated[
        bool, typer.Option("--trust", help="Run also code that the folder names and that you have not run from here.")
    ] = False,
) -> None:
    """Go on with every sweep that was begun in the results folder and is not complete.

    The configurations recorded then are run, whatever the manifests say today.
    """
    from rrmctl.running.config_file import code_files, needs_opengl
    from rrmctl.running.supervisor import Terms
    from rrmctl.store.provenance import read_config
    from rrmctl.store.snapshot import Snapshot

    screen = console(unfailing(sys.stderr))
    store = Snapshot(results, name, lenient=True)
    note_damage(store.damage)
    if not store.sweeps:
        begin = rrmctl("run", "quickstart", results=results)
        raise UserError(f"{results} holds no sweep", f"begin one, such as `{begin}`; `rrmctl list` shows the names")
    jobs = {job.id: job for sweep in store.sweeps for job in sweep.everything}
    left = {run: job for run, job in jobs.items() if _is_open(store.states[run], retry_failed=retry_failed)}
    for sweep in store.sweeps:
        count, total = sum(job.id in left for job in sweep.everything), runs(len(sweep.everything))
        screen.print(f"{sweep.experiment} ({sweep.variant}): {count} of {total} to go", soft_wrap=True)
    gone = unconfigured(store.layout, left.values())
    for command in remaking_commands(store, gone):
        screen.print(f"configurations are missing; this makes them, and the runs: {command}", soft_wrap=True)
    assigned: dict[Job, Terms] = {}
    code_of_users: dict[str, str] = {}  # digests by path
    drawing = []  # whether the runs need OpenGL
    for run, job in left.items():
        threads = 1
        with contextlib.suppress(UserError):  # the run's own worker refuses it with this message; the others go on
            config = read_config(store.layout.run(run))
            code_of_users |= code_files(config)
            threads = int(config["threads"])
            drawing.append(needs_opengl(store.layout.run(run), config))
        if run not in gone:
            assigned[job] = Terms(threads=threads, attempt=store.states[run].attempt)
    require_trust(results, code_of_users, trust=trust, asks=_asks())
    slots = workers or _slots(terms.threads for terms in assigned.values())
    _require_opengl(drawing)
    code = _train(screen, store.layout, assigned, slots, memory, hang_after)
    drain(screen.file)
    finish(store.layout, code, store.sweeps, damaged=bool(store.damage or gone))


def _slots(threads: Iterable[int]) -> int:
    """As many jobs at a time as the cores allow when each keeps its threads busy."""
    return max(1, usable_cores() // max(threads, default=1))


def _is_open(status: Status, *, retry_failed: bool) -> bool:
    """True for a run that is to be worked on. One that is running elsewhere is: it may be given up there."""
    return status.state != "done" and (status.state not in ("failed", "blocked") or retry_failed)


def _require_opengl(needed: Iterable[bool]) -> None:
    """Refuse runs that need it where there is none: they would all fail."""
    if any(needed):
        from rrm.rendering import renderer

        renderer()


def _asks() -> bool:
    """Whether there is a person to ask."""
    return sys.stdin.isatty() and sys.stderr.isatty()


def _record(console: Console, layout: Layout, plan: Plan) -> SweepRecord:
    """Write down what was asked for, and return it: first every run's configuration, then the sweep that names them."""
    from rrmctl.running.config_file import code_files, config_content
    from rrmctl.store.provenance import record_config
    from rrmctl.store.sweeps import SweepRecord, read_sweep, record_sweep, set_damaged_aside

    path = layout.sweep(plan.experiment, plan.variant)
    notes = [set_damaged_aside(layout, path)]  # one of another version is refused before anything is written
    before = read_sweep(path)
    sweep = SweepRecord(**{field.name: getattr(plan, field.name) for field in fields(SweepRecord)})
    contents = {job.id: config_content(plan.configs[job.id]) for job in plan.everything}
    remember(digest for content in contents.values() for digest in code_files(content).values())
    notes += [record_config(layout.run(run), content) for run, content in contents.items()]
    late = set(record_sweep(layout, sweep).superseded) - set(before.superseded if before else ())
    if late:
        count = f"{runs(len(late))} of other settings, files or versions gave way to what is asked for now"
        notes.append(f"{count}; `rrmctl clean` lists what nothing asks for any more")
    # Until the record named them, a `clean` may have removed some.
    lost = [run for run in contents if not layout.run(run).config.exists()]
    notes += [record_config(layout.run(run), contents[run]) for run in lost]
    for note in filter(None, notes):
        console.print(f"note: {note}", soft_wrap=True)
    return sweep


def _train(
    console: Console, layout: Layout, assigned: Mapping[Job, Terms], slots: int, memory: float | None, hang_after: float
) -> Exit:
    """Run the jobs, shown as bars at a terminal and as lines elsewhere. Memory in GiB, `hang_after` in minutes."""
    from rrmctl.cli.live import Bars, Lines
    from rrmctl.running.local import LocalExecutor
    from rrmctl.running.supervisor import Supervisor

    if not assigned:
        return Exit.DONE
    memory_limit = None if memory is None else int(memory * 2**30)
    executor = LocalExecutor(layout=layout, memory_limit=memory_limit, hang_after_s=hang_after * 60.0)
    watched = sys.stderr.isatty() and not console.is_dumb_terminal
    watcher = (Bars if watched else Lines)(console, layout, list(assigned))
    with watcher.progress if isinstance(watcher, Bars) else contextlib.nullcontext():
        return Supervisor(
            layout=layout, jobs=list(assigned), terms={job.id: terms for job, terms in assigned.items()}, slots=slots,
            watcher=watcher, executor=executor, asked=["rrmctl", *sys.argv[1:]],
        ).run()  # fmt: skip
