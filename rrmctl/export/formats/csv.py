"""Tidy CSV: evaluations.csv, runs.csv, and a data dictionary, datapackage.json.

`evaluations.csv` has a row for each evaluation with every label, `runs.csv` a row for each planned run with its state,
cost, machine and versions. `datapackage.json` says what each column means, in which unit, and which runs have no row;
it follows the Data Package standard. A missing number is an empty cell; numbers are written so that they read back
exactly.
"""

from __future__ import annotations

import json
from pathlib import Path

import rrm
from rrmctl.export.bundle import OTHER_RUN_COLUMNS, RUN_COLUMNS, Bundle, described
from rrmctl.store.files import write_bytes
from rrmctl.store.schema import SCHEMA_VERSION
from rrmctl.store.snapshot import table

#: Raised by one when a column of the files is added, removed, or changes its meaning.
CSV_VERSION = 1


def write(bundle: Bundle, folder: Path) -> list[Path]:
    """Write the three files into `folder`. Equal runs give equal bytes."""
    frames = {"evaluations": bundle.evaluations(), "runs": table(bundle.runs)}
    meanings = {"evaluations": described, "runs": (RUN_COLUMNS | OTHER_RUN_COLUMNS).__getitem__}
    dictionary = {
        "name": bundle.experiment,
        "title": f"Evaluations of the experiment {bundle.experiment}",
        "version": str(CSV_VERSION),
        "generator": {"rrmctl": rrm.__version__, "store_schema_version": SCHEMA_VERSION},
        "resources": [
            {
                "name": name,
                "path": f"{name}.csv",
                "format": "csv",
                "encoding": "utf-8",
                "schema": {
                    "fields": [
                        {"name": column, "type": kind, **({"unit": unit} if unit else {}), "description": meaning}
                        for column in map(str, frame)
                        for kind, unit, meaning in [meanings[name](column)]
                    ],
                    "missingValues": [""],
                },
            }
            for name, frame in frames.items()
        ],
        "planned_runs": len(bundle.runs),
        "runs_without_rows": [
            {**run.labels, "run": run.id, "state": run.plan["state"], "error": run.plan["error"]}
            for run in bundle.runs
            if run.curve.empty
        ],
    }
    texts = {f"{name}.csv": frame.to_csv(index=False, lineterminator="\n") for name, frame in frames.items()}
    texts["datapackage.json"] = json.dumps(dictionary, indent=1, ensure_ascii=False) + "\n"
    for name, text in texts.items():
        write_bytes(folder / name, text.encode())
    return [folder / name for name in texts]
