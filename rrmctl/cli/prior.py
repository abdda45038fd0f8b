"""`prior language`: the prompt for a language model, and what becomes of its answers."""

from __future__ import annotations

import json
import os
import shlex
from datetime import datetime
from pathlib import Path
from typing import Annotated

import typer

from rrm.files import place, read_bounded
from rrmctl.cli.options import ExperimentsOption
from rrmctl.cli.screen import tell
from rrmctl.errors import UserError

prior_app = typer.Typer(no_args_is_help=True, help="Prepare priors that are not functions of your own.")
language_app = typer.Typer(no_args_is_help=True, help="Priors that a language model writes, in any chat.")
prior_app.add_typer(language_app, name="language")

_LARGEST_PROMPT = 10_000_000  # bytes

TaskArgument = Annotated[str, typer.Argument(metavar="TASK", help="A task, such as button-press.")]


@language_app.command("prompt")
def prompt(
    task: TaskArgument,
    skeleton: Annotated[
        bool, typer.Option("--skeleton", help="End with the function that the answer is to fill in.")
    ] = False,
) -> None:
    """Print the prompt for a task: a line on it, its environment's source without the reward, and the instruction.

    Without --skeleton it is the paper's, and an answer has to be transcribed by hand.

    Example:

      rrmctl prior language prompt button-press --skeleton > prompt.txt
    """
    from rrm.envs.tasks import task as task_of
    from rrm.priors.language.prompt import make_prompt

    typer.echo(make_prompt(task_of(task), skeleton=skeleton), nl=False)


@language_app.command("add")
def add(
    task: TaskArgument,
    files: Annotated[
        list[Path],
        typer.Argument(parser=place, metavar="FILE...", help="Candidates, each with a function reward(step)."),
    ],
    model: Annotated[str, typer.Option("--model", help="Which model wrote them.")],
    date: Annotated[datetime, typer.Option("--date", formats=["%Y-%m-%d"], help="When it did.")],
    prompt_file: Annotated[
        Path | None,
        typer.Option(
            "--prompt", parser=place, metavar="FILE", help="The prompt that was sent. Default: that with the skeleton."
        ),
    ] = None,
    into: Annotated[
        Path | None,
        typer.Option(
            "--into", parser=place, metavar="DIR", help="Where to freeze it. Default: priors, beside the experiments."
        ),
    ] = None,
    experiments: ExperimentsOption = None,
) -> None:
    """Try candidates that a language model wrote, keep the best and freeze it with its origin as TASK.language.py.

    Candidates are not trusted: their code is rebuilt from a small subset of Python, which always ends, and tried on a
    random walk. The one that most agrees with the others is kept; the true reward is not looked at.

    Example:

      rrmctl prior language add button-press answer-*.py --model GPT-5 --date 2025-10-01
    """
    from rrm.envs.tasks import task as task_of
    from rrm.priors.language.candidates import freeze_best
    from rrm.priors.language.prompt import make_prompt
    from rrmctl.planning.experiments import OWN

    spec = task_of(task)
    try:
        text = read_bounded(prompt_file, _LARGEST_PROMPT).decode() if prompt_file else make_prompt(spec, skeleton=True)
    except OSError as error:
        raise UserError(f"cannot read {prompt_file}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        why = f"not UTF-8 text: {error.reason} at byte {error.start}"
        raise UserError(f"cannot read {prompt_file}: {why}") from None
    manifests = experiments or OWN
    folder = into or manifests.absolute().parent / "priors"
    target, record = freeze_best(spec, files, folder, model=model, date=f"{date:%Y-%m-%d}", prompt=text)
    for candidate in record.candidates:
        score = "the only one left" if candidate.score is None else f"{candidate.score:.4f}"
        kept = "*" if candidate.file == record.kept else " "
        tell(f"{kept} {candidate.refused or f'{candidate.file}: {score}'}")
    name = os.path.relpath(target)
    option = shlex.join(["--prior", f"{name}:reward"])
    line = f"prior = {json.dumps(f'{os.path.relpath(target, manifests)}:reward')}"  # manifests name files from there
    tell(f"\nfrozen: {name}\nuse it: {option}, or {line} in the [method.NAME] of a manifest in {manifests}")
