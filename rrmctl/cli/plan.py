"""Commands that look and run nothing: `list`, `plan` and `doctor`."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated, Any

import typer

from rrmctl.cli import options
from rrmctl.cli.executors import Options
from rrmctl.cli.request import Forecast, Request, advise, beside, duration, forecast, in_words
from rrmctl.errors import Exit, UserError
from rrmctl.terminal import stdout_console

if TYPE_CHECKING:
    from rich.table import Table

    from rrmctl.labels import Label
    from rrmctl.store.sweeps import Job

_STYLES = {"ok": "green", "note": "yellow", "missing": "bold red"}


def list_(experiments: options.ExperimentsOption = None, as_json: options.JsonOption = False) -> None:
    """List the experiments: what each compares, and which figure or table of the paper it makes.

    An experiment is one TOML file: those of rrmctl, and any in the folder `experiments`. Below stand the names that
    methods are made of, and the profiles.
    """
    from rich.table import Table

    from rrmctl.planning.experiments import available, replaced
    from rrmctl.planning.manifest import load
    from rrmctl.planning.methods import vocabulary
    from rrmctl.planning.plan import make_plan
    from rrmctl.planning.profiles import profiles

    good: list[dict[str, Any]] = []
    bad, paths = [], available(experiments)
    for path in paths.values():
        try:
            plan = make_plan(manifest := load(path))
        except UserError as error:
            bad.append(str(error))
            continue
        good.append({
            "name": manifest.name, "title": manifest.title, "reproduces": list(manifest.reproduces),
            "rule": manifest.rule, "profile": plan.profile, "jobs": len(plan.jobs), "path": str(path),
        })  # fmt: skip
    if as_json:
        typer.echo(json.dumps(good, indent=2))
    else:
        table = Table("experiment", "reproduces", "jobs", "profile", "what it compares", box=None, pad_edge=False)
        for entry in good:
            figures = ", ".join(entry["reproduces"])
            table.add_row(entry["name"], figures, str(entry["jobs"]), entry["profile"], entry["title"])
        console = stdout_console(soft_wrap=True)
        console.print(table)
        console.print(vocabulary())
        console.print(f"profiles: {', '.join(profiles())}")
        for name in replaced(paths):
            console.print(f"note: {name} is {paths[name]}, in place of the one that comes with rrmctl")
    if bad:
        raise UserError("\n".join(bad))


def plan(
    name: options.ExperimentArgument,
    profile: options.ScaleOption = None,
    seeds: options.SeedsOption = None,
    tasks: options.TasksOption = None,
    methods: options.MethodsOption = None,
    overrides: options.SetOption = None,
    prior: options.PriorOption = None,
    device: options.DeviceOption = None,
    results: options.ResultsOption = options.DEFAULT_RESULTS,
    experiments: options.ExperimentsOption = None,
    by_job: Annotated[bool, typer.Option("--jobs", help="One line a job instead of one a group of seeds.")] = False,
    as_json: options.JsonOption = False,
) -> None:
    """Show what `run` with the same options would do: the jobs, what they cost, and what is done already. Runs nothing.

    Examples:

      rrmctl plan main-results --seeds 10

      rrmctl plan main-results --profile laptop --tasks button-press --methods pebble,rrm-proxy

      rrmctl plan toy-car --set agent.batch=256 --set steps=20000

      rrmctl plan toy-car --prior my_priors.py:closer
    """
    from rrmctl.store.layout import new_results

    request = Request(name, experiments, profile, seeds, tasks, methods, overrides, prior, device)
    layout = new_results(results)
    expected = forecast(request.plan(), layout)
    plan = expected.plan
    if as_json:
        about: dict[str, Any] = {
            name: getattr(plan, name) for name in ("experiment", "profile", "variant", "overrides")
        }
        about |= {"core_hours": expected.hours, "core_hours_left": expected.hours_left, "unknown": expected.unknown}
        for part in ("jobs", "needed", "deployments"):
            about[part] = [
                asdict(job) | {"state": str(expected.states[job.id].state), "core_seconds": expected.seconds[job.id]}
                for job in getattr(plan, part)
            ]
        typer.echo(json.dumps(about, indent=2))
        return
    console = stdout_console(soft_wrap=True)
    console.print(f"{plan.experiment}: {plan.manifest.title}", style="bold")
    console.print(f"makes {', '.join(plan.manifest.reproduces)}; {plan.manifest.rule}")
    overridden = "".join(f" · {key} = {json.dumps(value)}" for key, value in plan.overrides.items())
    console.print(f"profile {plan.variant}{overridden}\n")
    console.print(_table(expected, by_job=by_job))
    states = ("done", "running", "interrupted", "failed", "blocked", "unreadable")
    there = ", ".join(f"{expected.count(state)} {state}" for state in states if expected.count(state))
    slots = Options(executor="local").slots((), len(plan.everything), expected.on_cards)
    words = in_words(expected, slots)
    console.print(f"\n{len(plan.jobs)} jobs{beside(plan)}, {there or 'none run yet'}. {words}")
    advise(console, request, expected, 0.0)


def _table(expected: Forecast, *, by_job: bool) -> Table:
    """One row for each group of seeds, or for each job."""
    from rich.table import Table

    table = Table("task", "method", "teacher", "feedback", "steps", box=None, pad_edge=False)
    for name in ("seed", "state", "run") if by_job else ("seeds", "done"):
        table.add_column(name, justify="left" if name in ("state", "run") else "right")
    table.add_column("core time each", justify="right")
    rows: dict[Label, list[Job]] = {}
    for job in expected.plan.everything:
        rows.setdefault(job.row, []).append(job)
    for names, jobs in rows.items():
        states = [str(expected.states[job.id].state) for job in jobs]
        for job, state in zip(jobs, states, strict=True) if by_job else ((jobs[0], ""),):
            which = (str(job.seed), state, job.id) if by_job else (str(len(jobs)), str(states.count("done")))
            seconds = expected.seconds[job.id]
            table.add_row(*names, f"{job.steps:,}", *which, "?" if seconds is None else duration(seconds / 3600))
    return table


def doctor(
    results: options.ResultsOption = options.DEFAULT_RESULTS,
    experiments: options.ExperimentsOption = None,
    as_json: options.JsonOption = False,
    tune: Annotated[bool, typer.Option(
        "--tune", help="Measure instead how many runs at a time each kind of graphics card here bears, in some "
        "minutes; `run` and `plan` go by it from then on.",
    )] = False,
    mps: Annotated[bool, typer.Option("--mps", help="With --tune: runs that share a card by NVIDIA's MPS.")] = False,
) -> None:  # fmt: skip
    """Check this machine: versions, simulators, rendering, cores, arithmetic, cards, disk. Says what is missing and the
    fix.

    Ends with 1 where something that is needed is missing. A note stops nothing: rendering and pybullet are for tasks
    that see images or drive the simulated robot arm.
    """
    from rich.text import Text

    from rrmctl.cli.tune import tune as measure
    from rrmctl.doctor import examine

    if tune:
        measure(as_json=as_json, mps=mps)
        return
    console = stdout_console(soft_wrap=True)
    checks = []
    for check in examine(results, experiments):
        checks.append(check)
        if not as_json:  # at once: some checks take a second
            console.print(Text.assemble((f"{check.state:8}", _STYLES[check.state]), f"{check.name:24}", check.found))
            if check.fix:
                console.print(Text(f"{'':8}fix: {check.fix}"))
    missing = sum(check.state == "missing" for check in checks)
    if as_json:
        typer.echo(json.dumps([asdict(check) for check in checks], indent=2))
    else:
        console.print(f"\n{missing} missing; see the fixes above." if missing else "\nReady.")
    raise typer.Exit(Exit.FAILED if missing else Exit.DONE)
