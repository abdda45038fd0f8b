"""Commands that messages and pages tell people to type, each as a shell takes it from where it is printed."""

from __future__ import annotations

import json
import os
import re
import shlex
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

DEFAULT_RESULTS = Path("results")

#: Text that `--set` reads as text without quotes around it.
_WORD = re.compile(r"(?!(?:true|false|inf|nan)$)[A-Za-z_][\w-]*")


def rrmctl(*words: str, results: str | Path | None = None) -> str:
    """An `rrmctl` command.

    Args:
        results: the results root that it is about; said where the command would not take it by itself.
    """
    default = Path(os.environ.get("RRMCTL_RESULTS") or DEFAULT_RESULTS)
    where = () if results is None or Path(results) == default else ("--results", str(results))
    return shlex.join(["rrmctl", *words, *where])


def run_command(
    experiment: str,
    profile: str,
    overrides: Mapping[str, Any],
    *,
    tasks: Iterable[str],
    methods: Iterable[str],
    seeds: Iterable[int],
    results: str | Path | None = None,
    force: bool = False,
) -> str:
    """The `rrmctl run` that asks for these tasks, each with all of these methods and seeds.

    Args:
        overrides: of the variant, by dotted name.
        results: as in `rrmctl`.
        force: train also what is done.
    """
    words = ["run", experiment, "--profile", profile]
    for key, value in overrides.items():
        words += ["--set", f"{key}={assigned(value)}"]
    numbers = list(dict.fromkeys(seeds))
    words += ["--tasks", ",".join(dict.fromkeys(tasks)), "--methods", ",".join(dict.fromkeys(methods))]
    words += ["--seeds", ",".join(map(str, numbers)) + ("," if len(numbers) == 1 else "")]
    return rrmctl(*words, *(["--force"] if force else []), results=results)


def assigned(value: Any) -> str:
    """A setting as `--set KEY=` takes it."""
    return value if isinstance(value, str) and _WORD.fullmatch(value) else json.dumps(value)
