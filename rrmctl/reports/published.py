"""The values of the paper's tables, from `published.toml`: shown beside ours, never part of them."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

PATH = Path(__file__).with_suffix(".toml")
NAN = float("nan")


@dataclass(frozen=True)
class Final:
    """A published success at the end of training."""

    success: float  #: fraction
    half: float  #: half the width of its 95 % interval, a fraction


@dataclass(frozen=True)
class Checkpoint:
    """A published evaluation on the physical robot."""

    step: int
    share: float  #: of the whole training
    success: float  #: fraction
    true_return: float


def source(table: str) -> str:
    """Where in the paper a table stands."""
    return str(_file()[table]["source"])


def final(task: str, teacher: str, method: str) -> Final | None:
    """What the paper's table of noisy teachers says of a method; None where it says nothing."""
    values = _file()["noisy-teacher"].get(task, {}).get(teacher, {}).get(method)
    return None if values is None else Final(values[0] / 100, values[1] / 100)


def deployed_tasks() -> list[str]:
    """The tasks of the paper's table of the physical robot, in its order."""
    return [name for name, value in _file()["sim-to-real"].items() if isinstance(value, dict)]


def checkpoints(task: str, method: str) -> list[Checkpoint]:
    """The checkpoints of a task in that table, with NaN as values where it says nothing of the method."""
    table = _file()["sim-to-real"][task]
    steps = table["steps"]
    told = table.get(method) or {name: [NAN] * len(steps) for name in ("success", "return")}
    values = zip(steps, told["success"], told["return"], strict=True)
    return [Checkpoint(step, step / table["length"], success / 100, each) for step, success, each in values]


@cache
def _file() -> dict[str, Any]:
    return tomllib.loads(PATH.read_text(encoding="utf-8"))
