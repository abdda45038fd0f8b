"""Profiles: the same experiments at another scale. All of their numbers stand in profiles.toml, beside this file."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal

from rrmctl.errors import check_known
from rrmctl.planning.toml import read_toml

PATH = Path(__file__).with_name("profiles.toml")

#: The scale at which manifests are written, and the default.
PAPER = "paper"

#: What a method does before the first update differs by kind: the reward is known, learned, or learned on a prior.
ProfileKind = Literal["known", "baseline", "residual"]


@dataclass(frozen=True)
class Profile:
    """A scale: settings for all runs, for suites and for single tasks, the narrower ones winning."""

    name: str
    about: str  #: one sentence for people
    chain: tuple[tuple[str, dict[str, Any]], ...]  #: (name, table) of what this profile builds on, itself last


@cache
def profiles() -> dict[str, Profile]:
    """Every profile by name."""
    scales: dict[str, Profile] = {}
    for name, table in read_toml(PATH).items():
        before = scales[table["like"]].chain if "like" in table else ()
        scales[name] = Profile(name, table["about"], (*before, (name, table)))
    return scales


def profile(name: str, where: str) -> Profile:
    """The profile of this name, which `where` asks for; where there is none, the nearest is suggested."""
    check_known(name, profiles(), f'{where}: unknown profile "{name}"')
    return profiles()[name]
