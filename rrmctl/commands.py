"""Commands that messages and pages tell people to type."""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

#: Text that `--set` reads as text without quotes around it.
_WORD = re.compile(r"(?!(?:true|false|inf|nan)$)[A-Za-z_][\w-]*")


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
        results: the results root; None leaves it to the reader's default.
        force: train also what is done.
    """
    words = ["rrmctl", "run", experiment, "--profile", profile]
    for key, value in overrides.items():
        words += ["--set", f"{key}={assigned(value)}"]
    numbers = list(dict.fromkeys(seeds))
    words += ["--tasks", ",".join(dict.fromkeys(tasks)), "--methods", ",".join(dict.fromkeys(methods))]
    words += ["--seeds", ",".join(map(str, numbers)) + ("," if len(numbers) == 1 else "")]
    words += [] if results is None else ["--results", str(results)]
    return shlex.join([*words, *(["--force"] if force else [])])


def assigned(value: Any) -> str:
    """A setting as `--set KEY=` takes it."""
    return value if isinstance(value, str) and _WORD.fullmatch(value) else json.dumps(value)
