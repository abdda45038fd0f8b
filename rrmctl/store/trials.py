"""What `run --until-decided` fixed before its first look: rules that follow from the results control no error."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import NamedTuple

from pydantic import StrictFloat, StrictInt, StrictStr

from rrmctl.errors import UserError
from rrmctl.labels import Label
from rrmctl.store.files import locked, remove_leftovers
from rrmctl.store.layout import Layout
from rrmctl.store.records import read_record, write_json
from rrmctl.store.schema import SCHEMA_VERSION


class Pairing(NamedTuple):
    """Two methods that are compared, and where."""

    task: StrictStr
    teacher: StrictStr
    feedback: StrictStr
    method: StrictStr
    against: StrictStr

    def __str__(self) -> str:
        where = Label(self.task, self.method, self.teacher, self.feedback).place
        return f"{where}, {self.method} against {self.against}"


@dataclass(frozen=True, kw_only=True)
class Trial:
    """The rules of one sequential test."""

    group: StrictInt  #: seeds of each method between two looks
    looks: StrictInt  #: at most
    alpha: StrictFloat  #: probability of any wrong decision
    pairs: tuple[Pairing, ...]  #: the comparisons that share it


def read_trial(layout: Layout, experiment: str, variant: str) -> Trial | None:
    """The test of this variant; None where none was begun."""
    path = layout.trial(experiment, variant)
    hint = "move it away to begin another test, whose error rate then no longer counts the looks of this one"
    return read_record(Trial, path, hint)


def begin_trial(layout: Layout, experiment: str, variant: str, trial: Trial) -> None:
    """Write down the rules of a test, or see that they are those of the test that was begun here: else a UserError."""
    path = layout.trial(experiment, variant)
    with locked(layout.sweep_lock(experiment)):
        remove_leftovers(path.parent)
        begun = read_trial(layout, experiment, variant)
        if begun is None:
            pairs = [pair._asdict() for pair in trial.pairs]
            write_json(path, {"schema_version": SCHEMA_VERSION, **asdict(trial), "pairs": pairs})
        elif begun != trial:
            raise UserError(
                f"{path}: a test with other rules was begun here: {_rules(begun)}; now asked for: {_rules(trial)}",
                "the options of then go on with it. Rules that change with what was seen control no error: "
                "begin another test in another --results folder",
            )


def _rules(trial: Trial) -> str:
    compared = "; ".join(dict.fromkeys(f"{pair.method} against {pair.against}" for pair in trial.pairs))
    tasks = ", ".join(dict.fromkeys(pair.task for pair in trial.pairs))
    return f"groups of {trial.group} seeds, at most {trial.group * trial.looks}, {compared} on {tasks}"
