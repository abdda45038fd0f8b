"""Profiles: the same experiments at another scale. All of their numbers stand in profiles.toml, beside this file."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, Literal

from rrm.errors import nearest
from rrmctl.errors import UserError, check_known
from rrmctl.planning.manifest import Settings, refuse_unknown
from rrmctl.planning.toml import read_toml

PATH = Path(__file__).with_name("profiles.toml")

#: The scale at which manifests are written, and the default.
PAPER = "paper"

#: What a method does before the first update differs by kind: the reward is known, learned, or learned on a prior.
ProfileKind = Literal["known", "baseline", "residual"]

_KINDS = ("known", "baseline", "residual")


@dataclass(frozen=True)
class Layer:
    """Settings and the place they were read from, which errors name."""

    where: str
    settings: Settings = field(hash=False)


@dataclass(frozen=True)
class Profile:
    """A scale: settings for all runs, for suites and for single tasks, the narrower ones winning."""

    name: str
    about: str  #: one sentence for people
    chain: tuple[tuple[str, dict[str, Any]], ...]  #: (name, table) of what this profile builds on, itself last

    def layers(self, suite: str, task: str, kind: ProfileKind) -> Iterator[Layer]:
        """The settings of one cell, widest first."""
        for name, table in self.chain:
            rooms = [("all", table.get("all", {}))]
            rooms += [(f"suite.{suite}", table.get("suite", {}).get(suite, {}))]
            rooms += [(f"task.{task}", table.get("task", {}).get(task, {}))]
            for room, settings in rooms:
                yield Layer(f"{PATH.name} [{name}.{room}]", {k: v for k, v in settings.items() if k not in _KINDS})
                yield Layer(f"{PATH.name} [{name}.{room}.{kind}]", settings.get(kind, {}))


@cache
def profiles() -> dict[str, Profile]:
    """Every profile by name.

    Raises:
        UserError: profiles.toml has a mistake in its structure.
    """
    table = read_toml(PATH)
    found: dict[str, Profile] = {}
    for name, entry in table.items():
        refuse_unknown(entry, {"about", "like", "all", "suite", "task"}, f"{PATH.name} [{name}]")
        base = entry.get("like")
        if base is not None and base not in found:
            raise UserError(f'{PATH.name} [{name}]: like = "{base}" names no profile above it{nearest(base, found)}')
        before = found[base].chain if base is not None else ()
        found[name] = Profile(name, entry["about"], (*before, (name, entry)))
    return found


def profile(name: str, where: str) -> Profile:
    """The profile of this name, which `where` asks for.

    Raises:
        UserError: there is none; the message suggests the nearest.
    """
    known = profiles()
    check_known(name, known, f'{where}: unknown profile "{name}"')
    return known[name]
