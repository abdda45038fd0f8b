"""Runs of one second, for `benchmarks.cluster`: the worker's process, lease, status, curve and log are real.

python -m benchmarks.second worker|task ARGUMENTS OF rrmctl.running.worker OR .slurm_task
"""

from __future__ import annotations

import sys
import time
from functools import partial
from pathlib import Path

from rrm.training.run_config import RunConfig
from rrmctl.running import local, slurm_task, worker
from rrmctl.running.monitor import RunMonitor
from tests.rrmctl.running.standin import Trainer, row

COMMAND = (sys.executable, "-m", "benchmarks.second")


class Sleeper(Trainer):
    """Trains nothing."""

    def perform(self, config: RunConfig, folder: Path, monitor: RunMonitor, results: dict[str, Path]) -> bool:  # noqa: ARG002
        time.sleep(1.0)
        monitor.row(row(config.steps, config.seed))
        with monitor.writing():
            (folder / "model.safetensors").write_bytes(b"")
        return True


if __name__ == "__main__":
    if sys.argv[1] == "worker":
        sys.exit(worker.main(sys.argv[2:], trainer=Sleeper()))
    local.LocalExecutor = partial(local.LocalExecutor, command=(*COMMAND, "worker"))  # type: ignore[misc,assignment]
    sys.exit(slurm_task.main(sys.argv[2:]))
