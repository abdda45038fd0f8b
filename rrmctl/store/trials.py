"""What `run --until-decided` fixed before its first look: rules that follow from the results control no error."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import NamedTuple

from rrmctl.errors import UserError
from rrmctl.store import validation
from rrmctl.store.files import DamagedError, locked, read_json, remove_leftovers, write_json
from rrmctl.store.layout import Layout
from rrmctl.store.schema import SCHEMA_VERSION


class Pairing(NamedTuple):
    """Two methods that are compared, and where."""

    task: str
    teacher: str
    feedback: str
    method: str
    against: str


@dataclass(frozen=True, kw_only=True)
class Trial:
    """The rules of one sequential test."""

    group: int  #: seeds of each method between two looks
    looks: int  #: at most
    alpha: float  #: probability of any wrong decision
    pairs: tuple[Pairing, ...]  #: the comparisons that share it


_TRIAL = {**dict.fromkeys(("group", "looks"), validation.WHOLE), "pairs": validation.LIST}


def read_trial(layout: Layout, experiment: str, variant: str) -> Trial | None:
    """The test of this variant; None where none was begun.

    Raises:
        UserError: its file is damaged, cannot be read now, or is of another schema version.
    """
    path = layout.trial(experiment, variant)
    content = read_json(path)
    if content is None:
        return None
    hint = "move it away to begin another test, whose error rate then no longer counts the looks of this one"
    validation.check_version(content, path, hint)
    validation.check(content, _TRIAL, path, hint)
    try:
        pairs = tuple(Pairing(**pair) for pair in content["pairs"])
        return Trial(group=content["group"], looks=content["looks"], alpha=float(content["alpha"]), pairs=pairs)
    except (KeyError, TypeError, ValueError) as problem:
        raise DamagedError(f"{path} is damaged: {problem}", hint) from problem


def begin_trial(layout: Layout, experiment: str, variant: str, trial: Trial) -> None:
    """Write down the rules of a test, or see that they are those of the test that was begun here.

    Raises:
        UserError: a test with other rules was begun here.
        StorageError: the results folder takes no write.
    """
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
