"""Commands about demonstrations: `demos collect` and `demos show`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from rrm.files import place
from rrmctl.cli.options import DEFAULT_RESULTS, ResultsOption
from rrmctl.cli.screen import tell
from rrmctl.errors import UserError

demos_app = typer.Typer(no_args_is_help=True, help="Collect demonstrations, or look at a file of them.")


@demos_app.command()
def collect(
    out: Annotated[Path, typer.Argument(parser=place, metavar="FILE", help="Where to write them; *.safetensors.")],
    run: Annotated[
        str | None, typer.Option("--run", metavar="RUN", help="A finished run, by the first digits of its id.")
    ] = None,
    scripted: Annotated[
        str | None, typer.Option("--scripted", metavar="TASK", help="Meta-World's scripted policy for this task.")
    ] = None,
    episodes: Annotated[int, typer.Option(min=1, help="How many.")] = 50,
    seed: Annotated[int, typer.Option(min=0, help="Of the instances that are played.")] = 0,
    least_success: Annotated[
        float, typer.Option(min=0, max=1, help="Share that must succeed, where the task has that notion.")
    ] = 0.8,
    results: ResultsOption = DEFAULT_RESULTS,
) -> None:
    """Have an expert play, deterministically, and write down every transition and where it comes from.

    A sweep collects what it needs by itself. For demonstrations of your own, hand the file to a run:

      rrmctl demos collect mine.safetensors --run 2dcd --results results

      rrmctl demos collect script.safetensors --scripted button-press

      rrmctl run main-results --methods rrm-imitation --set imitation.demos=mine.safetensors
    """
    from rrmctl.running import experts
    from rrmctl.store.files import storage_error
    from rrmctl.store.layout import find_run, open_results

    if run is not None and scripted is None:
        played = experts.play_run(find_run(open_results(results), run), episodes, seed, least_success)
    elif scripted is not None and run is None:
        played = experts.play_script(scripted, episodes, seed, least_success)
    else:
        raise UserError("whose demonstrations?", "name a finished run with --run, or a task with --scripted")
    try:
        played.save(out)
    except OSError as error:
        raise storage_error(out, error) from error
    tell(json.dumps(played.summary(), indent=1))


@demos_app.command()
def show(file: Annotated[Path, typer.Argument(parser=place, metavar="FILE", help="A file of demonstrations.")]) -> None:
    """Show where demonstrations come from, how many there are and how good they are, as JSON."""
    from rrmctl.running import experts

    typer.echo(json.dumps(experts.summary(file), indent=1))
