"""Every planned run with what there is to know of it: where it stands, what it ran with, what it spent, its curve."""

from __future__ import annotations

import datetime
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rrmctl.labels import Label
from rrmctl.store.frame import MAYBE_WHOLE, NUMBER, TEXT, frame
from rrmctl.store.layout import RunFolder
from rrmctl.store.provenance import read_provenance
from rrmctl.store.reader import PLANNED_KINDS, open_results, planned, read_config, read_curve
from rrmctl.store.schema import IDENTITY, LABELS, curve_schema

if TYPE_CHECKING:
    from collections.abc import Iterable

    import pandas as pd

#: Columns of `table`, beside those of `rrmctl.store.planned`.
FACTS = (
    "evaluations", "queries", "labels", "wall_s", "started", "host", "cpu", "platform", "python", "precision",
    "threads", "code", "config_version", "resumed", "versions",
)  # fmt: skip


@dataclass(frozen=True, kw_only=True, eq=False)
class Run:
    """A planned run under one of its labels."""

    plan: dict[str, Any]  #: its row of `rrmctl.store.planned`
    config: dict[str, Any] | None  #: None where it was never started
    provenance: dict[str, Any] | None  #: None where it was never started
    curve: pd.DataFrame  #: the columns `MEASURED` and its figures, by step; empty before the first evaluation

    @property
    def id(self) -> str:
        """Sixteen hexadecimal digits."""
        return str(self.plan["run"])

    @property
    def row(self) -> Label:
        """What it is called, whatever its seed."""
        return Label(*(self.plan[name] for name in Label._fields))

    @property
    def label(self) -> str:
        """For people, with its seed."""
        return self.row.seeded(self.plan["seed"])

    @property
    def labels(self) -> dict[str, Any]:
        """What it is called: experiment, variant, profile, task, method, teacher, feedback, seed."""
        return {name: self.plan[name] for name in LABELS}

    @property
    def started(self) -> float | None:
        """When its first attempt began, seconds since the epoch; None where that is not recorded."""
        told = (self.provenance or {}).get("started")
        return None if told is None else datetime.datetime.fromisoformat(told).timestamp()

    def facts(self) -> dict[str, Any]:
        """The columns `FACTS`; None where nothing is known."""
        known, last = self.provenance or {}, None if self.curve.empty else self.curve.iloc[-1]
        told = {name: known.get(name) for name in ("started", "host", "cpu", "platform", "python", "code")}
        setup = {name: (self.config or {}).get(name) for name in ("precision", "threads", "config_version")}
        return {
            "evaluations": len(self.curve),
            **{name: None if last is None else int(last[name]) for name in ("queries", "labels")},
            "wall_s": None if last is None else float(last["wall_s"]),
            **told, **setup,
            "resumed": len(known["resumed"]) if "resumed" in known else None,
            "versions": json.dumps(known["versions"], sort_keys=True) if "versions" in known else None,
        }  # fmt: skip


def inventory(
    results: str | Path = "results", experiment: str | None = None, *, needed: bool = False
) -> tuple[Run, ...]:
    """The planned runs of an experiment, or of all of them, in the order of the plan.

    Args:
        needed: instead of the planned runs those that they need: experts, demonstrations.

    Raises:
        UserError: the experiment has never been run here, or a file is damaged; the message names it.
    """
    layout = open_results(results)
    plans: list[dict[str, Any]] = planned(results, experiment, needed=needed).to_dict("records")  # type: ignore[assignment]
    return tuple(_run(layout.run(plan["run"]), plan) for plan in plans)


def _run(folder: RunFolder, plan: dict[str, Any]) -> Run:
    rows = read_curve(folder)
    curve: pd.DataFrame = (curve_schema().empty_table() if rows is None else rows).to_pandas(use_threads=False)
    config = read_config(folder) if folder.config.exists() else None
    return Run(plan=plan, config=config, provenance=read_provenance(folder), curve=curve.drop(columns=list(IDENTITY)))


def settings(config: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """The values of a configuration by dotted name; a list is one value."""
    found: dict[str, Any] = {}
    for name, value in config.items():
        inner = isinstance(value, Mapping)
        found |= settings(value, f"{prefix}{name}.") if inner else {prefix + name: value}
    return found


def table(runs: Iterable[Run]) -> pd.DataFrame:
    """One row for each run: the columns of `rrmctl.store.planned`, then `FACTS`, with what it spent."""
    whole = ("evaluations", "queries", "labels", "threads", "config_version", "resumed")
    facts = dict.fromkeys(FACTS, TEXT) | dict.fromkeys(whole, MAYBE_WHOLE) | {"wall_s": NUMBER}
    return frame((run.plan | run.facts() for run in runs), PLANNED_KINDS | facts)
