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
from rrmctl.export.formats import require
from rrmctl.store.files import storage_error
from rrmctl.store.records import read_json, write_json

#: In each exported run's folder: marks it as ours, and says what it holds.
_MARK = "rrmctl.json"


def write(bundle: Bundle, folder: Path) -> list[Path]:
    """Write an offline run for every run with an evaluation."""
    require("wandb")
    targets, new = [], []
    for content in _contents(bundle):
        # W&B's own pattern, with the run's start for the time.
        stamp = datetime.datetime.fromtimestamp(content["started"], datetime.UTC)
        target = folder / "wandb" / f"offline-run-{stamp:%Y%m%d_%H%M%S}-{content['id']}"
        mark = {"sha256": hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()}
        targets.append(target / f"run-{content['id']}.wandb")
        if read_json(target / _MARK) != mark:
            new.append((content, target, mark))
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=folder) as scratch:
            _have_written([content for content, _, _ in new], Path(scratch))
            for content, target, mark in new:
                pattern = f"wandb/offline-run-*-{content['id']}"
                for old in folder.glob(pattern):  # an earlier export's
                    if (old / _MARK).exists():
                        shutil.rmtree(old)
                written = next(Path(scratch).glob(pattern))
                write_json(written / _MARK, mark)
                target.parent.mkdir(exist_ok=True)
                written.rename(target)
    except OSError as error:
        raise storage_error(folder, error) from error
    return targets


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
            "rows": [
                {name: value for name, value in row.items() if math.isfinite(value)}
                | {"_timestamp": start + row["wall_s"]}
                for row in run.curve.to_dict("records")
            ],
            "summary": {name: plan[name] for name in ("state", "error", "attempt", "steps")},
            "exit_code": int(plan["state"] == "failed"),
        }


def _have_written(contents: Sequence[Mapping[str, Any]], folder: Path) -> None:
    """Have W&B write the runs, in a process of its own: this one may be a notebook with a W&B run under way."""
    if not contents:
        return
    own = {name: value for name, value in environment().items() if not name.startswith("WANDB_")}
    places = {f"WANDB_{name}_DIR": str(folder / name.lower()) for name in ("CACHE", "CONFIG", "DATA", "ARTIFACT")}
    ended = subprocess.run(
        [sys.executable, "-P", "-m", __name__, str(folder)],
        input=json.dumps(contents),
        env=own | places | {"WANDB_MODE": "offline", "WANDB_ERROR_REPORTING": "false"},
        capture_output=True,
        text=True,
        check=False,
    )
    if ended.returncode:
        reason = (ended.stderr.strip() or "no reason given").splitlines()[-1]
        raise UserError(f"wandb could not write the runs: {reason}")


def _write_offline(folder: str) -> None:
    """In that process: write what is on standard input to `folder/wandb/offline-run-*`."""
    import wandb

    settings = wandb.Settings(
        mode="offline", root_dir=folder, silent=True, console="off", disable_git=True, disable_code=True,
        disable_job_creation=True, x_disable_stats=True, x_disable_meta=True, x_disable_machine_info=True,
        x_save_requirements=False,
    )  # fmt: skip
    for content in json.load(sys.stdin):
        with wandb.init(**content["init"], id=content["id"], settings=settings) as run:
            run.define_metric("*", step_metric="step")
            for row in content["rows"]:
                run.log(row, step=row["step"])
            run.summary.update(content["summary"])
            run.finish(exit_code=content["exit_code"])


if __name__ == "__main__":
    _write_offline(sys.argv[1])
