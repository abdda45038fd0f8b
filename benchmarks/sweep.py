"""What a second worker on a second core is worth: four short runs through `rrmctl run`, by one worker and by two.

Start-up, evaluation and checkpoints are part of it, as they are of a sweep. Needs two free cores.
"""

from __future__ import annotations

import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from benchmarks.lines import Line

_MANIFEST = """
title = "Four short runs"
reproduces = ["nothing"]
rule = "None."
seeds = 4
default_profile = "laptop"

[grid]
tasks = ["button-press"]
methods = ["oracle"]

[profile.laptop]
steps = 5_000
evaluation.every = 2500
"""
_TURNS = 2


def lines() -> Iterator[Line]:
    """Throughput of two workers over that of one."""
    with tempfile.TemporaryDirectory() as name:
        manifest = Path(name) / "four.toml"
        manifest.write_text(_MANIFEST)
        rounds = [[_seconds(manifest, workers, turn) for workers in (1, 2)] for turn in range(_TURNS)]
    one, two = (statistics.median(column) for column in zip(*rounds, strict=True))
    yield Line(
        item="throughput of two workers over one", ours=one / two, unit="x", bound=1.85,
        note=f"four runs: {one:.0f} s and {two:.0f} s",
    )  # fmt: skip


def _seconds(manifest: Path, workers: int, turn: int) -> float:
    command = "from rrmctl.cli.app import main; main()"
    results = manifest.parent / f"results-{workers}-{turn}"
    start = time.perf_counter()
    subprocess.run(
        [sys.executable, "-c", command, "run", str(manifest), "--workers", str(workers), "--results", str(results)],
        check=True, capture_output=True,
    )  # fmt: skip
    return time.perf_counter() - start
