"""Commands that messages and pages tell people to type, each as a shell takes it from where it is printed."""

from __future__ import annotations

import itertools
import json
import os
import re
import shlex
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

DEFAULT_RESULTS = Path("results")

#: Text that `--set` reads as text without quotes around it.
_WORD = re.compile(r"(?!(?:true|false|inf|nan)$)[A-Za-z_][\w-]*")


def rrmctl(*words: str, results: str | Path | None = None) -> str:
    """An `rrmctl` command; the results root that it is about is said where it would not take that by itself."""
    default = Path(os.environ.get("RRMCTL_RESULTS") or DEFAULT_RESULTS)
    where = () if results is None or Path(results) == default else ("--results", str(results))
    return shlex.join(["rrmctl", *words, *where])


def run_commands(
    experiment: str,
    profile: str,
    overrides: Mapping[str, Any],
    runs: Iterable[tuple[str, str, int]],
    *,
    asked: Iterable[Sequence[str]] = (),
    options: Sequence[str] = (),
    results: str | Path | None = None,
) -> list[str]:
    """The `rrmctl run`s that ask for these runs and no other: a command for each task and set of seeds.

    Args:
        runs: task, method and seed of each.
        asked: commands that asked for such runs; where they looked for this experiment and these methods is said again.
        options: further ones that take no value.
    """
    seeds = defaultdict[tuple[str, str], set[int]](set)
    for task, method, seed in runs:
        seeds[task, method].add(seed)
    alike = defaultdict[tuple[str, tuple[int, ...]], list[str]](list)
    for (task, method), numbers in seeds.items():
        alike[task, tuple(sorted(numbers))].append(method)
    # Another experiment may have the run as well: only commands that name this one say where it comes from.
    naming = [words for words in asked if any(Path(word.removesuffix(".toml")).name == experiment for word in words)]
    said = [part for words in naming for word in words for part in (word.split("=", 1) if word[:2] == "--" else [word])]
    manifests = [word for word in said if word.endswith(".toml") and Path(word).stem == experiment]
    sources = dict.fromkeys(pair for pair in itertools.pairwise(said) if pair[0] in ("--experiments", "--prior"))
    changes = [word for key, value in overrides.items() for word in ("--set", f"{key}={assigned(value)}")]
    commands = []
    for (task, group), methods in alike.items():
        listed = ",".join(map(str, group)) + ("," if len(group) == 1 else "")
        words = ["run", (manifests or [experiment])[-1], "--profile", profile, *changes]
        for option, value in sources:
            if option == "--experiments" or f"rrm-{value.rpartition(':')[2]}" in methods:
                words += [option, value]
        words += ["--tasks", task, "--methods", ",".join(methods)]
        commands.append(" ".join([rrmctl(*words, "--seeds", listed, results=results), *options]))
    return commands


def assigned(value: Any) -> str:
    """A setting as `--set KEY=` takes it."""
    return value if isinstance(value, str) and _WORD.fullmatch(value) else json.dumps(value)
