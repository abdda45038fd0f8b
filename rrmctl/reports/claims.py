"""What the paper's prose says of its experiments, from `claims.toml`, as tests that a store can answer."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
from pydantic import ConfigDict
from pydantic.dataclasses import dataclass

from rrm.envs.tasks import ScoreKind
from rrmctl.reports.series import Series
from rrmctl.stats import Floats, Steps

PATH = Path(__file__).with_suffix(".toml")

_ARM = re.compile(
    r"([\w-]+)(?: \((?!\))(?P<teacher>[\w-]+(?=[,)]))?"
    r"(?:(?(teacher), )(?:(?P<full>full feedback)|(?P<field>batch|every|budget) x ([\d.]+)))?\))?"
)

_STRICT = ConfigDict(extra="forbid")

#: "above" is of two arms: their difference is above zero.
Relation = Literal["at least", "below", "above"]


class Arm(NamedTuple):
    """Which series of a task is meant."""

    words: str  #: `pebble`, `pebble (stochastic)`, `pebble (batch x 0.1)`, `mrn (mistaken-10, batch x 0.2)`
    method: str
    teacher: str | None  #: None: the task's only one
    #: Questions of a session, steps between two and questions in all (None: however many), by their proportion to the
    #: fullest schedule; None: the only one.
    budget: tuple[float, float, float | None] | None

    @classmethod
    def of(cls, words: str) -> Arm:
        """The arm that is so called; a `ValueError` where none can be."""
        match = _ARM.fullmatch(words)
        if match is None:
            raise ValueError(f"{PATH.name}: {words!r} is no method with its teacher or its feedback")
        share = float(match[5] or 1)
        budget = {
            None: None, "batch": (share, 1.0, None), "every": (1.0, share, None), "budget": (1.0, 1.0, share),
        }[match["field"] or (match["full"] and "budget")]  # fmt: skip
        return cls(words, match[1], match["teacher"], budget)


@dataclass(frozen=True, kw_only=True, config=_STRICT)
class Reading:
    """What is read of a series' curve."""

    words: str
    steps: Literal["last", "common", "all"] = "last"  #: the last one up to `until`, the box figure's, all up to `until`
    until: float = 1.0  #: share of the training
    measure: Literal["true_accuracy", "residual beyond prior"] | None = None  #: None: the score the paper reports
    unit: ScoreKind | None = None  #: how numbers are written; None: as the task's score
    spread: bool = False  #: the standard deviation of the seeds, not their interquartile mean
    tasks: Literal["pooled", "averaged"] = "pooled"  #: of several: one number of all seeds, or the mean of each task's

    def __post_init__(self) -> None:
        if self.steps == "common" and (self.spread or self.measure is not None or self.tasks != "pooled"):
            raise ValueError(
                f"{PATH.name}: {self.words!r}: at the common step the score is read, of all seeds together"
            )

    @property
    def pooled(self) -> bool:
        """Whether the seeds of several tasks are of one number; curves are averaged."""
        return self.tasks == "pooled" and self.steps != "all"

    def of(self, series: Series) -> tuple[Steps, Floats]:
        """All steps [T] at which it can be read, and the values there, [S, T]."""
        match self.measure:
            case None:
                return series.steps, series.values
            case "residual beyond prior":  # by how much the residual's mean is further from zero than the prior's
                steps, residual = series.measure("residual_mean")
                return steps, np.abs(residual) - np.abs(series.measure("prior_mean")[1])
            case column:
                return series.measure(column)


@dataclass(frozen=True, config=_STRICT)
class Test:
    """One comparison: of an arm with a bound, or with another arm."""

    __test__ = False  # pytest takes everything called so for its own

    arm: Arm
    relation: Relation
    than: float | Arm
    reading: Reading

    def __str__(self) -> str:
        if isinstance(self.than, Arm):
            return f"{self.arm.words} {self.relation} {self.than.words}"
        bound = f"{self.than:g}" if self.reading.unit == "return" else f"{100 * self.than:g} %"
        return f"{self.arm.words} {self.relation} {bound}"


@dataclass(frozen=True, kw_only=True, config=_STRICT)
class Claim:
    """A sentence of the paper and the comparisons that it stands for; it holds where all of them do."""

    name: str
    says: str  #: the paper's words, shortened
    where: str  #: section or figure
    experiment: str
    tasks: tuple[str, ...]
    tests: tuple[Test, ...]
    pooled: bool = False  #: all tasks in one number; otherwise each by itself


def read_claims(content: Mapping[str, Any]) -> tuple[Claim, ...]:
    """The claims of a file like `claims.toml`; a ValueError or KeyError says what it lacks or has too much.

    An entry of a claim's `tests` stands for comparisons of each arm with each of the others, or with the bound.
    """
    readings = {name: Reading(**reading) for name, reading in content["readings"].items()}
    claims = []
    for claim in content["claims"]:
        tests = []
        for entry in claim["tests"]:
            relations: list[Relation] = [name for name in get_args(Relation) if name in entry]
            if len(relations) != 1 or entry.keys() != {"arms", "reading", *relations}:
                kinds = get_args(Relation)
                raise ValueError(f"{PATH.name}: a test has arms, a reading and one of {kinds}, not {entry}")
            (relation,) = relations
            for than in map(Arm.of, entry[relation]) if relation == "above" else [entry[relation]]:
                tests += [Test(Arm.of(words), relation, than, readings[entry["reading"]]) for words in entry["arms"]]
        claims.append(Claim(**claim | {"tests": tuple(tests)}))
    return tuple(claims)


CLAIMS = read_claims(tomllib.loads(PATH.read_text(encoding="utf-8")))
