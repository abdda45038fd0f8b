"""`rrmctl show`: everything that is known of one run."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from rrm.files import place, write_atomically
from rrmctl.cli.deploy import told
from rrmctl.cli.options import DEFAULT_RESULTS, ResultsOption
from rrmctl.cli.screen import plain_json, tell
from rrmctl.cli.status import note_damage
from rrmctl.cli.summary import rerun_command
from rrmctl.errors import UserError
from rrmctl.store.schema import IDENTITY, MEASURED
from rrmctl.terminal import stdout_console

if TYPE_CHECKING:
    from rrmctl.store.layout import Layout, RunFolder

#: So many evaluations are shown.
_LAST = 5


def show(
    run: Annotated[str, typer.Argument(metavar="RUN", help="A run's id, or enough of its first digits.")],
    results: ResultsOption = DEFAULT_RESULTS,
    lines: Annotated[int, typer.Option("--lines", min=0, help="Lines of the log's end.")] = 15,
    frames: Annotated[
        Path | None,
        typer.Option("--frames", parser=place, metavar="FILE", help="Write what its agent sees there, as PNG."),
    ] = None,
    film: Annotated[
        Path | None,
        typer.Option("--film", parser=place, metavar="FILE", help="Film an episode of its policy: .webm or .mp4."),
    ] = None,
    checkpoint: Annotated[
        int | None, typer.Option("--checkpoint", min=1, metavar="STEP", help="Film what it did after this step.")
    ] = None,
    episode: Annotated[
        int | None, typer.Option("--episode", min=0, metavar="N", help="Film this one of the evaluation, from 0 on.")
    ] = None,
    cameras: Annotated[
        bool, typer.Option("--cameras", help="Film an arm at the simulated workplace, by the cameras there.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON for programs.")] = False,
) -> None:
    """Show one run: what it is, where it stands, what it ran with, its last evaluations and the end of its log.

    With --frames, what the agent of a run on pictures sees: of those it has stored, or of an episode of random actions.
    With --film, an episode of its policy, as its evaluation plays it; with --cameras, as `rrmctl deploy` does.
    """
    from rrmctl.store.layout import find_run, open_results

    if film is None and (cameras or checkpoint is not None or episode is not None):
        raise UserError("--checkpoint, --episode and --cameras say what to film", "name a file with --film")
    layout = open_results(results)
    if frames is not None:
        _draw(find_run(layout, run), frames)
    if film is not None:
        from rrmctl.running import film as films

        tell(f"{film}: {films.film(find_run(layout, run), film, checkpoint, episode or 0, cameras=cameras)}")
    if frames is not None or film is not None:
        return
    facts = _facts(layout, find_run(layout, run), lines)
    if as_json:
        typer.echo(plain_json(facts))
        return
    console = stdout_console()
    for title, text in _sections(facts).items():
        if text:
            console.print(title, style="bold")
            console.print(text, soft_wrap=True)
            console.print()


def _draw(folder: RunFolder, path: Path) -> None:
    from rrmctl.running.pictures import sheet
    from rrmctl.store.files import storage_error

    png, words = sheet(folder)
    try:
        write_atomically(path, png)
    except OSError as error:
        raise storage_error(path, error) from error
    tell(f"{path}: {words}")


def _facts(layout: Layout, folder: RunFolder, lines: int) -> dict[str, Any]:
    """What there is to know, as JSON has it; what could not be read is null, and why stands in `damage`."""
    from rrmctl.running.deployments import deployed, kept
    from rrmctl.store.curve import read_curve
    from rrmctl.store.provenance import read_config, read_provenance
    from rrmctl.store.status import log_tail, run_status
    from rrmctl.store.sweeps import readable_sweeps

    damage: dict[str, str] = {}

    def read(name: str, of: Callable[[], Any]) -> Any:
        try:
            return of()
        except UserError as error:
            damage[name] = f"{error} ({error.hint})" if error.hint else str(error)
            return None

    def last_rows() -> list[dict[str, Any]]:
        table = read_curve(folder)
        return [] if table is None else table.slice(max(0, table.num_rows - _LAST)).to_pylist()

    sweeps, unread = readable_sweeps(layout)
    note_damage(unread)
    uses = [
        {"experiment": sweep.experiment, "variant": sweep.variant, "superseded": old, **asdict(job), "label": job.label}
        for sweep in sweeps
        for jobs, old in ((sweep.everything, False), (sweep.superseded, True))
        for job in jobs
        if job.id == folder.id
    ]
    return {
        "run": folder.id,
        "path": str(folder.path),
        "uses": uses,
        "state": asdict(run_status(folder)),
        "config": read("config", lambda: read_config(folder)),
        "provenance": read("provenance", lambda: read_provenance(folder)),
        "evaluations": read("evaluations", last_rows),
        "networks": kept(folder),
        "deployments": read("deployments", lambda: deployed(folder)),
        "log": log_tail(folder, lines) if lines else [],
        "again": [rerun_command(layout, s, job) for s in sweeps for job in s.jobs if job.id == folder.id],
        "damage": damage,
    }


def _sections(facts: Mapping[str, Any]) -> dict[str, str]:
    """The same for people, by title."""
    from rrmctl.store.status import RunError

    now, damage, made_by = facts["state"], facts["damage"], facts["provenance"]
    uses = (f"{use['experiment']}: {use['label']}{', superseded' * use['superseded']}" for use in facts["uses"])
    state = f"{now['state']}, attempt {now['attempt']}, step {now['step']:,}"
    state += f" of {now['steps']:,}" if now["steps"] else ""
    return {
        f"run {facts['run']}": "\n".join([facts["path"], *uses]),
        "state": f"{state}\n{RunError(**now['error']) if now['error'] else ''}".strip(),
        "configuration": damage.get("config") or json.dumps(facts["config"], indent=1),
        "provenance": damage.get("provenance") or (json.dumps(made_by, indent=1) if made_by else ""),
        "last evaluations": damage.get("evaluations") or "\n".join(map(_row, facts["evaluations"])),
        "networks kept": f"of steps {', '.join(map(str, facts['networks']))}" if facts["networks"] else "",
        "deployments": damage.get("deployments") or "\n".join(map(_deployed, facts["deployments"])),
        "end of the log": "\n".join(facts["log"]),
        "again, from nothing": "\n".join(facts["again"]),
    }


def _deployed(policy: Mapping[str, Any]) -> str:
    return f"step {policy['step']:>9,}  {told(policy)}  ({policy['file']})"


def _row(row: Mapping[str, Any]) -> str:
    from rrmctl.cli.live import score

    success = row["success"] if row["success"] == row["success"] else None  # NaN: the task has no success
    measured = f"step {row['step']:>9,}  {score(success, row['true_return'])}  return {row['true_return']:,.1f}"
    figures = (name for name in row if name not in IDENTITY | MEASURED and row[name] == row[name])  # NaN: nothing yet
    return "  ".join((measured, *(f"{name} {row[name]:.3g}" for name in figures)))
