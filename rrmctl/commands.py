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
    """An `rrmctl` command.

    Args:
        results: the results root that it is about; said where the command would not take it by itself.
    """
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
        overrides: of the variant, by dotted name.
        runs: task, method and seed of each.
        asked: commands that asked for such runs; where they looked for this experiment and these methods is said again.
        options: further ones that take no value.
        results: as in `rrmctl`.
    """
    seeds: defaultdict[tuple[str, str], set[int]] = defaultdict(set)
    for task, method, seed in runs:
        seeds[task, method].add(seed)
    alike: defaultdict[tuple[str, tuple[int, ...]], list[str]] = defaultdict(list)
    for (task, method), found in seeds.items():
        alike[task, tuple(sorted(found))].append(method)
    known = [list(words) for words in asked]
    changes = [word for key, value in overrides.items() for word in ("--set", f"{key}={assigned(value)}")]
    commands = []
    for (task, numbers), methods in alike.items():
        name, sources = _found(known, experiment, methods)
        listed = ",".join(map(str, numbers)) + ("," if len(numbers) == 1 else "")
        words = ["run", name, "--profile", profile, *changes, *sources, "--tasks", task, "--methods", ",".join(methods)]
        commands.append(" ".join([rrmctl(*words, "--seeds", listed, results=results), *options]))
    return commands


def _found(asked: Iterable[Sequence[str]], experiment: str, methods: Sequence[str]) -> tuple[str, list[str]]:
    """What such commands call the experiment, and the options that say where it and these methods come from."""
    name = experiment
    options: dict[tuple[str, str], None] = {}
    for command in asked:
        called = [word for word in command if Path(word.removesuffix(".toml")).name == experiment]
        if not called:
            continue  # it asked for another experiment, which has the run as well
        words = [part for word in command for part in (word.split("=", 1) if word.startswith("--") else [word])]
        for word, value in itertools.pairwise([*words, ""]):
            if word in called and word.endswith(".toml"):
                name = word
            if word == "--experiments" or (word == "--prior" and f"rrm-{value.rpartition(':')[2]}" in methods):
                options[word, value] = None
    return name, [word for pair in options for word in pair]


def assigned(value: Any) -> str:
    """A setting as `--set KEY=` takes it."""
    return value if isinstance(value, str) and _WORD.fullmatch(value) else json.dumps(value)
