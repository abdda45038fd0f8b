"""Commands that run: `run` and `resume`."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterable
from dataclasses import fields, replace
from typing import TYPE_CHECKING, Annotated

import typer

from rrmctl.cli import options
from rrmctl.cli.executors import Options, Work, train
from rrmctl.cli.label import labelling
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
    device: options.DeviceOption = None,
    workers: options.WorkersOption = None,
    memory: options.MemoryOption = None,
    hang_after: options.HangOption = options.HANG_AFTER_MIN,
    executor: options.ExecutorOption = "local",
    slurm: options.SlurmOption = None,
    at_once: options.AtOnceOption = None,
    pack: options.PackOption = None,
    address: options.AddressOption = None,
    gpus: options.GpusOption = None,
    per_gpu: options.PerGpuOption = None,
    mps: options.MpsOption = False,
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
    label: Annotated[
        bool, typer.Option("--label", help="Serve the questions to people beside it, as `rrmctl label NAME` does.")
    ] = False,
) -> None:
    """Run an experiment, or go on with it: runs that are done are skipped, interrupted ones continue.

    Ctrl-C once lets every job write a checkpoint and leave; twice ends them at once. Any number of `run`s may share a
    results folder: they divide the jobs between them.

    With --executor slurm, what is neither done nor queued nor running is submitted as job arrays, and the command
    leaves, with 75 until all is done: `rrmctl status NAME` tells how far it is, and the same command submits what was
    lost. With --executor ray, the nodes of a cluster run them while the command lasts. docs/cluster.md has both.

    With --until-decided every method is compared with one of them on every task, by its seeds' mean scores over
    training, after each group of seeds; what is decided runs no further seeds. The probability of any wrong decision is
    at most 5 % over all comparisons and looks, for rules that are fixed at the first call.

    Examples:

      rrmctl run quickstart

      rrmctl run main-results --seeds 10 --profile laptop

      rrmctl run main-results --tasks button-press --methods pebble,rrm-proxy --seeds 0,3,7 --workers 2

      rrmctl run toy-car --set agent.batch=256 --prior my_priors.py:closer

      rrmctl run toy-car --until-decided --max-seeds 20 --against pebble

      rrmctl run main-results --device cuda --gpus 0,1 --per-gpu 8

      rrmctl run main-results --executor slurm --slurm=--account=x --slurm=--time=8:00:00

      rrmctl run main-results --executor ray --address head:6379
    """
    from rrm.devices import CPU
    from rrmctl.cli.until_decided import asked_rules, until_decided
    from rrmctl.running.supervisor import Terms
    from rrmctl.store.drivers import driving
    from rrmctl.store.layout import new_results
    from rrmctl.store.status import Status, statuses
    from rrmctl.store.sweeps import readable_sweeps

    screen = console(unfailing(sys.stderr))
    request = Request(name, experiments, profile, seeds, tasks, methods, overrides, prior, device)
    gpus = request.card if gpus is None and executor == "local" else gpus
    how = Options(
        executor=executor, workers=workers, memory=memory, hang_after=hang_after, label=label, slurm=slurm,
        at_once=at_once, pack=pack, address=address, gpus=gpus, per_gpu=per_gpu, mps=mps,
    )  # fmt: skip
    rules = asked_rules(until, max_seeds, group, against, other=seeds is not None or force)
    request = replace(request, seeds=str(rules.most)) if rules else request
    layout = new_results(results)
    plan = request.plan()
    note_damage(readable_sweeps(layout)[1])
    expected = forecast(plan, layout)
    anew = {job.id for job in (*plan.jobs, *plan.deployments)} if force else set()

    def wanted(job: Job, status: Status) -> bool:
        return job.id in anew or _is_open(status, retry_failed=retry_failed)

    begun = [plan.configs[job.id] for job in plan.everything if wanted(job, expected.states[job.id])]
    if how.local:
        _require_devices(getattr(config, "device", CPU) for config in begun)
    threads = (config.threads for config in plan.configs.values())
    slots = how.slots(threads, len(plan.everything), expected.on_cards)
    before = replace(expected, states=dict.fromkeys(expected.states, Status())) if force else expected
    introduce(screen, request, before, slots)
    if rules:
        screen.print(f"  note: at most; what is decided after a group of {rules.group} seeds runs no more of them")
    drain(screen.file)
    _require((config.task for config in begun), (config.needs_opengl for config in begun if how.local))

    def execute(part: Plan) -> tuple[Exit, SweepRecord]:
        sweep, states = _record(screen, layout, part), statuses(layout, part.everything)
        assigned = {
            job: Terms(threads=part.configs[job.id].threads, attempt=states[job.id].attempt, fresh=job.id in anew)
            for job in part.everything
            if wanted(job, states[job.id])
        }
        return train(Work(screen, layout, assigned, [sweep]), how), sweep

    large = expected.hours_left > LARGE_H and any(wanted(job, expected.states[job.id]) for job in plan.everything)
    if large and not yes and _asks() and not typer.confirm("Start?", err=True):
        raise typer.Exit(Exit.INCOMPLETE)
    with driving(layout, [plan.experiment], how.again), labelling(name, layout) if label else contextlib.nullcontext():
        code, sweep = until_decided(layout, plan, rules, execute) if rules else execute(plan)
    drain(screen.file)
    finish(layout, code, [sweep], closing=plan.manifest.closing, again=how.again)


@resumable()
def resume(
    name: Annotated[
        str | None, typer.Argument(metavar="[NAME]", help="Only this experiment. Default: all in the results folder.")
    ] = None,
    workers: options.WorkersOption = None,
    memory: options.MemoryOption = None,
    hang_after: options.HangOption = options.HANG_AFTER_MIN,
    executor: options.ExecutorOption = "local",
    slurm: options.SlurmOption = None,
    at_once: options.AtOnceOption = None,
    pack: options.PackOption = None,
    address: options.AddressOption = None,
    gpus: options.GpusOption = None,
    per_gpu: options.PerGpuOption = None,
    mps: options.MpsOption = False,
    results: options.ResultsOption = options.DEFAULT_RESULTS,
    retry_failed: options.RetryOption = False,
    trust: Annotated[
        bool, typer.Option("--trust", help="Run also code that the folder names and that you have not run from here.")
    ] = False,
) -> None:
    """Go on with every sweep that was begun in the results folder and is not complete.

    The configurations recorded then are run, whatever the manifests say today.
    """
    from rrm.devices import CPU
    from rrmctl.running.config_file import code_files, needs_opengl
    from rrmctl.running.supervisor import Terms
    from rrmctl.store.drivers import driving
    from rrmctl.store.provenance import read_config
    from rrmctl.store.snapshot import Snapshot

    screen = console(unfailing(sys.stderr))
    how = Options(
        executor=executor, workers=workers, memory=memory, hang_after=hang_after,
        slurm=slurm, at_once=at_once, pack=pack, address=address, gpus=gpus, per_gpu=per_gpu, mps=mps,
    )  # fmt: skip
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
    tasks, drawing, devices = [], [], []  # and whether the runs need OpenGL
    for run, job in left.items():
        threads = 1
        with contextlib.suppress(UserError):  # the run's own worker refuses it with this message; the others go on
            config = read_config(store.layout.run(run))
            code_of_users |= code_files(config)
            threads = int(config["threads"])
            tasks.append(str(config.get("task")))
            devices.append(str(config.get("device", CPU)))
            drawing.append(needs_opengl(store.layout.run(run), config))
        if run not in gone:
            assigned[job] = Terms(threads=threads, attempt=store.states[run].attempt)
    drain(screen.file)
    require_trust(results, code_of_users, trust=trust, asks=_asks())
    if how.local:
        _require_devices(devices)
    _require(tasks, drawing if how.local else ())
    with driving(store.layout, {sweep.experiment for sweep in store.sweeps}, how.again):
        code = train(Work(screen, store.layout, assigned, store.sweeps), how)
    drain(screen.file)
    finish(store.layout, code, store.sweeps, damaged=bool(store.damage or gone), again=how.again)


def _is_open(status: Status, *, retry_failed: bool) -> bool:
    """True for a run that is to be worked on. One that is running elsewhere is: it may be given up there."""
    return status.state != "done" and (status.state not in ("failed", "blocked") or retry_failed)


def _require(tasks: Iterable[str], opengl: Iterable[bool]) -> None:
    """Refuse runs whose simulator or OpenGL is not here: they would all fail."""
    from rrm.envs.tasks import TASKS, require

    for name in sorted(TASKS.keys() & set(tasks)):
        require(TASKS[name])
    if any(opengl):
        from rrm.rendering import renderer

        renderer()


def _require_devices(devices: Iterable[str]) -> None:
    """Refuse runs on a graphics card where there is none that can be used."""
    from rrm.devices import check_device

    for device in sorted(set(devices)):
        check_device(device)


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
