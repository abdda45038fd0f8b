"""Tidy CSV: evaluations.csv, runs.csv, and a data dictionary, datapackage.json.

`evaluations.csv` has a row for each evaluation with every label, `runs.csv` a row for each planned run with its state,
cost, machine and versions. `datapackage.json` says what each column means, in which unit, and which runs have no row;
it follows the Data Package standard. A missing number is an empty cell; numbers are written so that they read back
exactly.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import rrm
from rrmctl.export.bundle import RUN_COLUMNS, Bundle, Field, described
from rrmctl.store.files import write_bytes
from rrmctl.store.schema import SCHEMA_VERSION
from rrmctl.store.snapshot import table

if TYPE_CHECKING:
    import pandas as pd

#: Raised by one when a column of the files is added, removed, or changes its meaning.
CSV_VERSION = 1

#: Columns of runs.csv that evaluations.csv lacks, or uses for something else.
OTHER_RUN_COLUMNS: dict[str, Field] = {
    "overrides": Field("string", "", "settings that were changed for the whole variant, JSON"),
    "attempt": Field("integer", "", "how often a worker took the run up"),
    "step": Field("integer", "environment steps", "last known step of the run"),
    "steps": Field("integer", "environment steps", "length of the run"),
    "error": Field("string", "", "why it failed; empty where it did not"),
    "evaluations": Field("integer", "rows", "its rows in evaluations.csv"),
    "queries": Field("integer", "queries", "queries put to the teacher"),
    "labels": Field("integer", "labels", "labels kept"),
    "wall_s": Field("number", "s", "training time, interruptions left out"),
    "started": Field("string", "", "when its first attempt began, ISO 8601"),
    "host": Field("string", "", "name of the machine"),
    "cpu": Field("string", "", "processor of the machine"),
    "platform": Field("string", "", "system and machine type"),
    "python": Field("string", "", "version of Python"),
    "precision": Field("string", "", "of the products between hidden layers"),
    "threads": Field("integer", "threads", "threads of torch"),
    "code": Field("string", "", "digest of the library's sources"),
    "config_version": Field("integer", "", "version of the configuration; another one is other random streams"),
    "resumed": Field("integer", "", "how often it went on after an interruption"),
    "versions": Field("string", "", "versions of the packages that can change a number, JSON"),
}


def write(bundle: Bundle, folder: Path) -> list[Path]:
    """Write the three files into `folder`. Equal runs give equal bytes.

    Raises:
        StorageError: the folder takes no write.
    """
    rows, runs = bundle.evaluations(), table(bundle.runs)
    files = {
        "evaluations.csv": _text(rows),
        "runs.csv": _text(runs),
        "datapackage.json": json.dumps(
            _dictionary(bundle, list(rows.columns), list(runs.columns)), indent=1, ensure_ascii=False
        )
        + "\n",
    }
    for name, text in files.items():
        write_bytes(folder / name, text.encode())
    return [folder / name for name in files]


def _text(frame: pd.DataFrame) -> str:
    text: str = frame.to_csv(index=False, lineterminator="\n")
    return text


def _dictionary(bundle: Bundle, columns: list[str], run_columns: list[str]) -> dict[str, Any]:
    empty = [
        {**run.labels, "run": run.id, "state": run.plan["state"], "error": run.plan["error"]}
        for run in bundle.runs
        if run.curve.empty
    ]
    return {
        "name": bundle.experiment,
        "title": f"Evaluations of the experiment {bundle.experiment}",
        "version": str(CSV_VERSION),
        "generator": {"rrmctl": rrm.__version__, "store_schema_version": SCHEMA_VERSION},
        "resources": [
            _resource("evaluations", {name: described(name) for name in columns}),
            _resource("runs", {name: (RUN_COLUMNS | OTHER_RUN_COLUMNS)[name] for name in run_columns}),
        ],
        "planned_runs": len(bundle.runs),
        "runs_without_rows": empty,
    }


def _resource(resource: str, columns: dict[str, Field]) -> dict[str, Any]:
    fields = [
        {"name": name, "type": kind, **({"unit": unit} if unit else {}), "description": meaning}
        for name, (kind, unit, meaning) in columns.items()
    ]
    schema = {"fields": fields, "missingValues": [""]}
    return {"name": resource, "path": f"{resource}.csv", "format": "csv", "encoding": "utf-8", "schema": schema}
