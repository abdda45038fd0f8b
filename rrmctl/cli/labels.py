"""Commands about the answers of people: `labels show`, `labels export` and `labels import`."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rrm.files import place
from rrmctl.cli.options import DEFAULT_RESULTS, ResultsOption
from rrmctl.cli.progress import runs
from rrmctl.cli.screen import tell
from rrmctl.errors import UserError
from rrmctl.terminal import stdout_console

if TYPE_CHECKING:
    from rrm.teachers.labels import Label
    from rrmctl.store.layout import Layout

labels_app = typer.Typer(no_args_is_help=True, help="Look at the answers of people, or take them along.")


@labels_app.command()
def show(
    name: Annotated[str | None, typer.Argument(metavar="[NAME]", help="Only this experiment. Default: all.")] = None,
    results: ResultsOption = DEFAULT_RESULTS,
) -> None:
    """Count answers by run and person: those that count, skipped and undone ones, and how many runs have learned from.

    Practice, and what everybody is asked, belongs to no run.
    """
    from rich.table import Table

    from rrm.teachers.labels import SKIPPED
    from rrmctl.store.layout import open_results

    layout = open_results(results)
    names, labels = _of_study(layout, name)
    table = Table(box=None, pad_edge=False)
    for column in ("run", "", "purpose", "by"):
        table.add_column(column)
    for column in ("answers", "skipped", "undone", "sealed"):
        table.add_column(column, justify="right")
    counts: Counter[tuple[tuple[str, str, str], str]] = Counter()
    for label in labels:
        about = (label.run, label.purpose, label.annotator)
        counts[about, "undone" if label.undone else "answers"] += 1
        counts[about, "skipped"] += label.answer == SKIPPED and not label.undone
        counts[about, "sealed"] += label.sealed
    for about in dict.fromkeys(about for about, _ in counts):
        run, purpose, annotator = about
        numbers = (str(counts[about, column] or "-") for column in ("answers", "skipped", "undone", "sealed"))
        table.add_row(run or "-", names.get(run, ""), purpose, annotator, *numbers)
    stdout_console().print(table if labels else f"{layout.root} holds no answers of people.")


@labels_app.command()
def export(
    first: Annotated[str, typer.Argument(metavar="[NAME] FILE", help="An experiment (default: all); the file.")],
    second: Annotated[str | None, typer.Argument(hidden=True)] = None,
    results: ResultsOption = DEFAULT_RESULTS,
) -> None:
    """Write every answer to an experiment's runs, and those that belong to no run, into one parquet file.

    A run of the same settings learns from it what the run did that people taught, without them:

      rrmctl labels export human-study answers.parquet

      rrmctl run human-study --set teacher.kind=replay --set teacher.labels=answers.parquet
    """
    from rrm.teachers.labels import write_labels
    from rrmctl.store.files import storage_error
    from rrmctl.store.layout import open_results

    layout, (name, file) = open_results(results), (None, first) if second is None else (first, second)
    if name is None and file in layout.experiments():
        raise UserError(f"{file} is an experiment; no file was named", f"`rrmctl labels export {file} FILE`")
    _, labels = _of_study(layout, name)
    if not labels:
        raise UserError(f"{layout.root} holds no answers of people", "there is nothing to export")
    try:
        write_labels(place(file), labels)
    except OSError as error:
        raise storage_error(place(file), error) from error
    tell(f"{file}: {len(labels):,} answers to {runs(len({label.run for label in labels} - {''}))}")


@labels_app.command("import")
def import_(
    file: Annotated[Path, typer.Argument(parser=place, metavar="FILE", help="As `labels export` writes it.")],
    results: ResultsOption = DEFAULT_RESULTS,
) -> None:
    """Add the answers in a file to the same runs of this results folder; those that are there are not doubled."""
    from rrm.teachers.labels import read_labels
    from rrmctl.store.labels import import_labels
    from rrmctl.store.layout import open_results

    layout, labels = open_results(results), read_labels(file)
    if not labels:
        raise UserError(f"{file} holds no answers", "see that it is there, and not empty")
    new = import_labels(layout, labels, str(file))
    tell(f"{sum(new.values()):,} answers are new, of {len(labels):,} to {runs(len(set(new) - {''}))}")


def _of_study(layout: Layout, name: str | None) -> tuple[dict[str, str], list[Label]]:
    """What the runs of an experiment are called, and all answers to them and to none."""
    from rrmctl.store.labels import stored_labels
    from rrmctl.store.sweeps import read_sweeps

    names = {job.id: job.label for sweep in read_sweeps(layout, name) for job in sweep.everything}
    return names, stored_labels(layout, names if name is not None else [*names, *(set(layout.run_ids()) - set(names))])
