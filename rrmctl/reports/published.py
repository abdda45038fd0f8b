"""The values of the paper's tables, from `published.toml`: shown beside ours, never part of them."""

from __future__ import annotations

import math
import tomllib
from pathlib import Path
from typing import NamedTuple

from rrm.envs.tasks import ScoreKind

PATH = Path(__file__).with_suffix(".toml")
_VALUES = tomllib.loads(PATH.read_text(encoding="utf-8"))


class Checkpoint(NamedTuple):
    """A published evaluation on the physical robot."""

    step: int
    share: float  #: of the whole training
    scores: dict[ScoreKind, float]  #: success as a fraction


def source(table: str) -> str:
    """Where in the paper a table stands."""
    return str(_VALUES[table]["source"])


def final(task: str, teacher: str, method: str) -> tuple[float, float]:
    """What the paper's table of noisy teachers says of a method: success at the end, and half its 95 % interval.

    Both are fractions, NaN where it says nothing.
    """
    success, half = _VALUES["noisy-teacher"].get(task, {}).get(teacher, {}).get(method, (math.nan, math.nan))
    return success / 100, half / 100


def deployed_tasks() -> list[str]:
    """The tasks of the paper's table of the physical robot, in its order."""
    return [name for name, value in _VALUES["sim-to-real"].items() if isinstance(value, dict)]


def length(task: str) -> int:
    """Steps of the paper's training of such a task."""
    return int(_VALUES["sim-to-real"][task]["length"])


def checkpoints(task: str, method: str) -> list[Checkpoint]:
    """The checkpoints of a task in that table, with NaN as values where it says nothing of the method."""
    table = _VALUES["sim-to-real"][task]
    steps, missing = table["steps"], [math.nan] * len(table["steps"])
    own = table.get(method, {"success": missing, "return": missing})
    return [
        Checkpoint(step, step / table["length"], {"success": success / 100, "return": value})
        for step, success, value in zip(steps, own["success"], own["return"], strict=True)
    ]
