"""Code that a results folder names: `resume` asks before it runs what somebody else planned.

What this user has run from here is known by its content, in a file of the user's own.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterable, Mapping
from pathlib import Path

import typer

from rrm.files import make_folder, read_bounded
from rrmctl.errors import Exit, UserError
from rrmctl.terminal import spelled

_LARGEST = 2**24  # bytes; a file of code takes 65


def _record() -> Path:
    """Raises RuntimeError where nobody has a home."""
    named = os.environ.get("XDG_STATE_HOME")
    return (Path(named) if named else Path.home() / ".local" / "state") / "rrmctl" / "trusted"


def _trusted() -> frozenset[str]:
    try:
        return frozenset(read_bounded(_record(), _LARGEST).decode().split())
    except (OSError, RuntimeError, UnicodeDecodeError):
        return frozenset()


def remember(digests: Iterable[str]) -> None:
    """Take note of code that its user wants run. Where that cannot be kept, `resume` will ask."""
    new = sorted({*digests} - _trusted())
    with contextlib.suppress(OSError, RuntimeError):
        if new:
            make_folder(_record().parent)
            with _record().open("a", encoding="utf-8") as file:
                file.write("".join(f"{digest}\n" for digest in new))


def require_trust(root: Path, code: Mapping[str, str], *, trust: bool, asks: bool) -> None:
    """See that the user wants code to be run, and take note of it.

    Args:
        code: digests of files, by path.
        trust: it was said beforehand.
        asks: there is a person to ask, who may leave.

    Raises:
        UserError: nobody said so.
    """
    trusted = _trusted()
    foreign = [path for path, digest in code.items() if digest not in trusted]
    if foreign and not trust:
        problem = f"{root} has runs with code that you have not run from here before:\n  " + "\n  ".join(foreign)
        if not asks:
            raise UserError(problem, "look at it; --trust runs it")
        typer.echo(spelled(problem), err=True)
        if not typer.confirm("Run it?", err=True):
            raise typer.Exit(Exit.INCOMPLETE)
    remember(code.values())
