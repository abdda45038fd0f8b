"""Commands that look and run nothing: `list`, `plan` and `doctor`."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Annotated, Any

import typer

from rrmctl.cli.options import (
    DEFAULT_RESULTS,
    ExperimentArgument,
    ExperimentsOption,
    MethodsOption,
    PriorOption,
    ProfileOption,
    ResultsOption,
    SeedsOption,
    SetOption,
    TasksOption,
)
from rrmctl.cli.request import Forecast, Request, duration, forecast, in_words, smaller
from rrmctl.errors import Exit, UserError
from rrmctl.terminal import stdout_console

if TYPE_CHECKING:
    from rrmctl.planning.manifest import Manifest
    from rrmctl.planning.plan import Plan
    from rrmctl.store.sweeps import Job

JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON for programs instead of a table.")]

_STYLES = {"ok": "green", "note": "yellow", "missing": "bold red"}


def list_(experiments: ExperimentsOption = None, as_json: JsonOption = False) -> None:
    """List the experiments: what each compares, and which figure or table of the paper it makes.

    An experiment is one TOML file: those of rrmctl, and any in the folder `experiments`. Below stand the names that
    methods are made of.
    """
    from rich.table import Table

    from rrmctl.planning.experiments import available, replaced
    from rrmctl.planning.manifest import load
    from rrmctl.planning.methods import vocabulary

    good, bad, found = [], [], available(experiments)
    for path in found.values():
        try:
            good.append(_described(load(path)))
        except UserError as error:
            bad.append(str(error))
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
        for name in replaced(found):
            console.print(f"note: {name} is {found[name]}, in place of the one that comes with rrmctl")
    if bad:
        raise UserError("\n".join(bad))


def _described(manifest: Manifest) -> dict[str, Any]:
    from rrmctl.planning.plan import make_plan

    plan = make_plan(manifest)
    return {
        "name": manifest.name, "title": manifest.title, "reproduces": list(manifest.reproduces), "rule": manifest.rule,
        "profile": plan.profile, "jobs": len(plan.jobs), "path": str(manifest.path),
    }  # fmt: skip


def plan(
    name: ExperimentArgument,
    profile: ProfileOption = None,
    seeds: SeedsOption = None,
    tasks: TasksOption = None,
    methods: MethodsOption = None,
    overrides: SetOption = None,
    prior: PriorOption = None,
    results: ResultsOption = DEFAULT_RESULTS,
    experiments: ExperimentsOption = None,
    each: Annotated[bool, typer.Option("--jobs", help="One line a job instead of one a group of seeds.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Show what `run` with the same options would do: the jobs, what they cost, and what is done already. Runs nothing.

    Examples:

      rrmctl plan main-results --seeds 10

      rrmctl plan main-results --profile laptop --tasks button-press --methods pebble,rrm-proxy

      rrmctl plan toy-car --set agent.batch=256 --set steps=20000

      rrmctl plan toy-car --prior my_priors.py:closer
    """
    from rrmctl.hardware import usable_cores
    from rrmctl.planning.warnings import notes
    from rrmctl.store.layout import new_results

    request = Request(name, experiments, profile, seeds, tasks, methods, overrides, prior)
    layout = new_results(results)
    planned = request.plan()
    expected = forecast(planned, layout)
    if as_json:
        typer.echo(json.dumps(_as_json(expected), indent=2))
        return
    console = stdout_console(soft_wrap=True)
    manifest = planned.manifest
    console.print(f"{planned.experiment}: {manifest.title}", style="bold")
    console.print(f"makes {', '.join(manifest.reproduces)}; {manifest.rule}")
    console.print(f"profile {planned.variant}{_overridden(planned)}\n")
    console.print(_table(expected, each=each))
    counts = [f"{expected.count(s)} {s}" for s in ("done", "running", "interrupted", "failed", "blocked", "unreadable")]
    there = ", ".join(text for text in counts if not text.startswith("0 "))
    more = f" and {len(planned.needed)} that they need" if planned.needed else ""
    told = f"{len(planned.jobs)} jobs{more}, {there or 'none run yet'}."
    console.print(f"\n{told} {in_words(expected, usable_cores())}")
    for line in notes(planned, usable_cores()):
        console.print(f"  note: {line}")
    if expected.hours_left > 0:
        for line in smaller(request, planned):
            console.print(f"  smaller: {line}")


def _overridden(plan: Plan) -> str:
    return "".join(f" · {key} = {json.dumps(value)}" for key, value in plan.overrides.items())


def _table(expected: Forecast, *, each: bool) -> Any:
    """One row for each group of seeds, or for each job."""
    from rich.table import Table

    table = Table("task", "method", "teacher", "feedback", "steps", box=None, pad_edge=False)
    for name in ("seed", "state", "run") if each else ("seeds", "done"):
        table.add_column(name, justify="left" if name in ("state", "run") else "right")
    table.add_column("core time each", justify="right")
    groups: dict[tuple[str, str, str, str], list[Job]] = {}
    for job in expected.plan.everything:
        groups.setdefault(job.row, []).append(job)
    for names, jobs in groups.items():
        common = (*names, f"{jobs[0].steps:,}")
        states = [str(expected.states[job.id].state) for job in jobs]
        costs = [duration(expected.cost.seconds[job.id] / 3600) for job in jobs]
        if not each:
            table.add_row(*common, str(len(jobs)), str(states.count("done")), costs[0])
            continue
        for job, state, cost in zip(jobs, states, costs, strict=True):
            table.add_row(*common, str(job.seed), state, job.id, cost)
    return table


def _as_json(expected: Forecast) -> dict[str, Any]:
    plan = expected.plan
    return {
        "experiment": plan.experiment, "profile": plan.profile, "variant": plan.variant, "overrides": plan.overrides,
        "core_hours": expected.cost.core_hours(), "core_hours_left": expected.hours_left,
        "jobs": [_job_as_json(expected, job) for job in plan.jobs],
        "needed": [_job_as_json(expected, job) for job in plan.needed],
    }  # fmt: skip


def _job_as_json(expected: Forecast, job: Job) -> dict[str, Any]:
    return {
        "id": job.id, "cell": job.cell, **job.row._asdict(), "seed": job.seed, "steps": job.steps,
        "requires": list(job.requires),
        "state": str(expected.states[job.id].state), "core_seconds": expected.cost.seconds[job.id],
    }  # fmt: skip


def doctor(
    results: ResultsOption = DEFAULT_RESULTS,
    experiments: ExperimentsOption = None,
    as_json: JsonOption = False,
) -> None:
    """Check this machine: versions, simulators, rendering, cores, precision, disk. Says what is missing and the fix.

    Ends with 1 where something that is needed is missing. A note stops nothing: rendering and pybullet are for tasks
    that see images or drive the simulated robot arm.
    """
    from dataclasses import asdict

    from rich.text import Text

    from rrmctl.doctor import examine

    console = stdout_console(soft_wrap=True)
    found = []
    for check in examine(results, experiments):
        found.append(check)
        if not as_json:  # at once: some checks take a second
            console.print(Text.assemble((f"{check.state:8}", _STYLES[check.state]), f"{check.name:24}", check.found))
            if check.fix:
                console.print(Text(f"{'':8}fix: {check.fix}"))
    missing = [check for check in found if check.state == "missing"]
    if as_json:
        typer.echo(json.dumps([asdict(check) for check in found], indent=2))
    else:
        console.print(f"\n{len(missing)} missing; see the fixes above." if missing else "\nReady.")
    raise typer.Exit(Exit.FAILED if missing else Exit.DONE)
