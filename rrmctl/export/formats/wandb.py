"""Weights & Biases offline runs, for `wandb sync`; needs `pip install 'rrmctl[wandb]'`.

Below the folder: wandb/offline-run-*, one a run, in the project that is named like the experiment. Nothing is sent and
nobody is asked for an account. A row's `_timestamp` is the start of the run's first attempt plus its training time so
far (from 1970 where no start was recorded). W&B counts `_runtime` itself, from the export; training time is `wall_s`.
Exporting again leaves runs alone that have not changed and replaces the others, under the same id.
"""

from __future__ import annotations

import datetime
import hashlib
import json
import math
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from rrm.environ import environment
from rrmctl.errors import UserError
from rrmctl.export.bundle import Bundle
from rrmctl.export.extras import require
from rrmctl.store.files import storage_error
from rrmctl.store.records import read_json, write_json

#: In each exported run's folder: marks it as ours, and says what it holds.
_MARK = "rrmctl.json"


def write(bundle: Bundle, folder: Path) -> list[Path]:
    """Write an offline run for every run with an evaluation.

    Raises:
        UserError: the package wandb is missing, or failed.
        StorageError: the folder takes no write.
    """
    require("wandb")
    contents = list(_contents(bundle))
    new = [content for content in contents if read_json(_target(folder, content) / _MARK) != _mark(content)]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=folder) as scratch:
            _write_offline(new, Path(scratch))
            for content in new:
                _put(next(Path(scratch).glob(f"wandb/offline-run-*-{content['id']}")), folder, content)
    except OSError as error:
        raise storage_error(folder, error) from error
    return [_target(folder, content) / f"run-{content['id']}.wandb" for content in contents]


def _contents(bundle: Bundle) -> Iterator[dict[str, Any]]:
    """What W&B is told of each run: arguments of `wandb.init`, rows, summary and exit code."""
    seen: Counter[str] = Counter()
    for run in bundle.begun:
        plan, start = run.plan, run.started or 0.0
        seen[run.id] += 1  # one that two labels share is there for each of them
        yield {
            "id": run.id if seen[run.id] == 1 else f"{run.id}-{seen[run.id]}",
            "started": start,
            "init": {
                "project": bundle.experiment,
                "group": " ".join([plan["variant"], *run.row.words]),
                "name": run.label,
                "job_type": plan["profile"],
                "tags": [plan["state"]],
                "config": {**(run.config or {}), "plan": run.labels, "provenance": run.provenance},
            },
            "rows": [_row(row, start) for row in run.curve.to_dict("records")],
            "summary": {name: plan[name] for name in ("state", "error", "attempt", "steps")},
            "exit_code": int(plan["state"] == "failed"),
        }  # fmt: skip


def _row(row: Mapping[Any, Any], start: float) -> dict[str, Any]:
    measured = {name: value for name, value in row.items() if math.isfinite(value)}
    return measured | {"_timestamp": start + row["wall_s"]}


def _mark(content: Mapping[str, Any]) -> dict[str, Any]:
    return {"sha256": hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()}


def _target(folder: Path, content: Mapping[str, Any]) -> Path:
    """Where the run is kept: W&B's own pattern, with the run's start for the time."""
    stamp = datetime.datetime.fromtimestamp(content["started"], datetime.UTC)
    return folder / "wandb" / f"offline-run-{stamp:%Y%m%d_%H%M%S}-{content['id']}"


def _put(made: Path, folder: Path, content: Mapping[str, Any]) -> None:
    """Move an offline run to its place, and remove the one that an earlier export left."""
    for old in folder.glob(f"wandb/offline-run-*-{content['id']}"):
        if (old / _MARK).exists():
            shutil.rmtree(old)
    write_json(made / _MARK, _mark(content))
    target = _target(folder, content)
    target.parent.mkdir(exist_ok=True)
    made.rename(target)


def _write_offline(contents: Sequence[Mapping[str, Any]], folder: Path) -> None:
    """Have W&B write the runs, in a process of its own: this one may be a notebook with a W&B run under way.

    Raises:
        UserError: it failed.
    """
    if not contents:
        return
    own = {name: value for name, value in environment().items() if not name.startswith("WANDB_")}
    places = {f"WANDB_{name}_DIR": str(folder / name.lower()) for name in ("CACHE", "CONFIG", "DATA", "ARTIFACT")}
    ended = subprocess.run(
        [sys.executable, "-P", "-m", "rrmctl.export.offline", str(folder)],
        input=json.dumps(contents),
        env=own | places | {"WANDB_MODE": "offline", "WANDB_ERROR_REPORTING": "false"},
        capture_output=True,
        text=True,
        check=False,
    )
    if ended.returncode:
        raise UserError(
            f"wandb could not write the runs: {(ended.stderr.strip() or 'no reason given').splitlines()[-1]}"
        )
