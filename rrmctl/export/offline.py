"""The process in which W&B writes offline runs: reads them as JSON from standard input, writes below a folder."""

from __future__ import annotations

import json
import sys
from typing import Any


def write(content: dict[str, Any], folder: str) -> None:
    """Write one run, as `rrmctl.export.formats.wandb` describes it, to `folder/wandb/offline-run-*`."""
    import wandb

    settings = wandb.Settings(
        mode="offline",
        root_dir=folder,
        silent=True,
        console="off",
        disable_git=True,
        disable_code=True,
        disable_job_creation=True,
        x_disable_stats=True,
        x_disable_meta=True,
        x_disable_machine_info=True,
        x_save_requirements=False,
    )
    with wandb.init(**content["init"], id=content["id"], settings=settings) as run:
        run.define_metric("*", step_metric="step")
        for row in content["rows"]:
            run.log(row, step=row["step"])
        run.summary.update(content["summary"])
        run.finish(exit_code=content["exit_code"])


def main() -> None:
    """Write all runs."""
    for content in json.load(sys.stdin):
        write(content, sys.argv[1])


if __name__ == "__main__":
    main()
