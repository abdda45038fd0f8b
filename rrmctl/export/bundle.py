"""What is exported, and what its columns mean."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from rrmctl.store.frame import NUMBER, TEXT, WHOLE, frame, typed
from rrmctl.store.layout import check_profile
from rrmctl.store.snapshot import Run, Snapshot

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, eq=False)
class Bundle:
    """The runs of one experiment."""

    experiment: str
    runs: tuple[Run, ...]  #: all that were planned, also those without an evaluation

    @property
    def begun(self) -> tuple[Run, ...]:
        """Those with at least one evaluation, finished or not."""
        return tuple(run for run in self.runs if len(run.curve))

    def evaluations(self) -> pd.DataFrame:
        """One row for each run and evaluation, with every label: the columns of `rrmctl.store.load`."""
        import pandas as pd

        kinds = {name: _KINDS[field.kind] for name, field in COLUMNS.items()}
        tables = [run.curve.assign(**{name: run.plan[name] for name in RUN_COLUMNS}) for run in self.begun]
        return typed(pd.concat([frame([], kinds), *tables], ignore_index=True), kinds)


def read(results: str | Path, experiment: str, profile: str | None = None) -> Bundle:
    """The runs of an experiment, of one profile or of all.

    Raises:
        UserError: no such experiment or profile, or a file is damaged; the message names it.
    """
    runs = Snapshot(results, experiment).runs()
    check_profile(profile, (str(run.plan["profile"]) for run in runs))
    return Bundle(experiment, tuple(run for run in runs if profile in (None, run.plan["profile"])))


class Field(NamedTuple):
    """What a column holds, for a data dictionary."""

    kind: str  #: string, integer or number
    unit: str  #: empty where there is none
    meaning: str


_KINDS = {"string": TEXT, "integer": WHOLE, "number": NUMBER}
_TOLD = {
    section: {name: Field(entry["type"], entry.get("unit", ""), entry["meaning"]) for name, entry in columns.items()}
    for section, columns in tomllib.loads(Path(__file__).with_name("columns.toml").read_text(encoding="utf-8")).items()
}

#: Columns that say which run a row belongs to.
RUN_COLUMNS = _TOLD["run"]

#: Every column that each evaluation has, in order.
COLUMNS = RUN_COLUMNS | _TOLD["measured"]

#: Columns of runs.csv that evaluations.csv lacks, or uses for something else.
OTHER_RUN_COLUMNS = _TOLD["other"]


def described(column: str) -> Field:
    """What a column of `Bundle.evaluations` holds; all figures are there, whether or not more is known of them."""
    figure = Field("number", "", "a figure of the run's agent or source of rewards; missing where it has none")
    return COLUMNS.get(column) or _TOLD["figure"].get(column, figure)
