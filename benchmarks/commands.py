"""Commands from a cold process: wall time from start to exit, median of five after one that warms the disk's cache.

The stores they read are made for the purpose, by the store's own writers, of plans of real experiments; making them is
not timed. What a command prints is looked at, so that none is quick because it found nothing.
"""

from __future__ import annotations

import itertools
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from benchmarks.lines import Line
from rrmctl.planning.manifest import load
from rrmctl.planning.plan import Plan, make_plan
from rrmctl.running.config_file import config_content
from rrmctl.store.curve import SETTINGS, table_of
from rrmctl.store.files import try_lock, write_table
from rrmctl.store.layout import Layout, RunFolder
from rrmctl.store.provenance import record_config
from rrmctl.store.schema import IDENTITY, MEASURED
from rrmctl.store.status import RunState, Status, write_status
from rrmctl.store.sweeps import Job, SweepRecord, record_sweep

EXPERIMENTS = Path(__file__).parents[1] / "experiments"
PROGRAM = (sys.executable, "-c", "from rrmctl.cli.app import main; main()")
PROFILE = "paper"
SEEDS = 334  # of the thirty runs a seed of main-results: ten thousand
TURNS = 5
EVALUATIONS = 100
REPLICATES = 2_000

#: A sweep under way: how many of every hundred runs stand where.
SHARES = {RunState.DONE: 80, RunState.FAILED: 1, RunState.INTERRUPTED: 5, RunState.RUNNING: 2, RunState.QUEUED: 12}


def lines() -> list[Line]:
    many, few = plan_of("main-results", SEEDS), plan_of("ablation-residual", 17)  # the latter 24 runs a seed
    with tempfile.TemporaryDirectory(prefix="rrmctl-benchmark-") as folder:
        nothing, begun, done = (Path(folder) / name for name in ("nothing", "begun", "done"))
        write_sweep(Layout(begun), many, write_progress)
        write_sweep(Layout(done), few, write_curve)
        planned = (
            "plan",
            many.experiment,
            "--profile",
            PROFILE,
            "--seeds",
            str(SEEDS),
            "--experiments",
            str(EXPERIMENTS),
        )
        report = ("report", "iqm", "--results", str(done), "--replicates", str(REPLICATES))
        jobs, runs = len(many.jobs), len(few.jobs)
        return [
            _line("rrmctl --help", 0.3, ("--help",), "Usage"),
            _line(f"rrmctl plan, {jobs:,} jobs", 2.0, (*planned, "--results", str(nothing)), "none run yet"),
            _line(f"rrmctl plan, {jobs:,} jobs begun", 2.0, (*planned, "--results", str(begun)), "interrupted"),
            _line(f"rrmctl status, {jobs:,} runs", 1.5, ("status", "--results", str(begun)), f"of {jobs} runs"),
            _line(f"rrmctl report iqm, {runs} runs x {EVALUATIONS}", 5.0, report, "success tasks"),
        ]


def plan_of(experiment: str, seeds: int) -> Plan:
    return make_plan(load(EXPERIMENTS / f"{experiment}.toml"), profile=PROFILE, seeds=seeds)


def write_sweep(layout: Layout, plan: Plan, write: Callable[[int, Plan, Job, RunFolder], None]) -> None:
    """A sweep's record, and each of its runs as `write` has it. Threads, because every write waits for the disk."""
    record = SweepRecord(
        experiment=plan.experiment, variant=plan.variant, profile=plan.profile, overrides=plan.overrides, jobs=plan.jobs
    )
    record_sweep(layout, record)
    with ThreadPoolExecutor(max_workers=32) as threads:
        list(threads.map(lambda at, job: write(at, plan, job, layout.run(job.id)), itertools.count(), plan.jobs))


def write_progress(number: int, _plan: Plan, job: Job, folder: RunFolder) -> None:
    """Where a run stands in a sweep under way. What says it is running has lost its process: nobody holds its lock."""
    states = [state for state, share in SHARES.items() for _ in range(share)]
    state = states[number % len(states)]
    if state is RunState.QUEUED:
        return
    step = job.steps if state is RunState.DONE else job.steps // 3
    descriptor = try_lock(folder.lock)
    assert descriptor is not None
    write_status(folder, _status(state, step, job.steps))
    os.close(descriptor)


def _status(state: RunState, step: int, steps: int) -> Status:
    return Status(
        state=state, attempt=1, step=step, steps=steps, rows=EVALUATIONS * step // steps, success=0.5,
        true_return=1234.5, steps_per_s=123.4, wall_s=step / 123.4, pid=1234, host="node", started=1.7e9,
        heartbeat=1.7e9 + step / 123.4,
    )  # fmt: skip


def write_curve(number: int, plan: Plan, job: Job, folder: RunFolder) -> None:
    """A run that is done: its configuration, its evaluations, its state."""
    rng = np.random.default_rng(number)
    success = rng.binomial(10, np.clip(rng.uniform(0.2, 1.2) * np.linspace(0.0, 1.0, EVALUATIONS), 0.0, 1.0)) / 10
    config, steps = config_content(plan.configs[job.id]), job.steps
    identity = {name: config["id" if name == "run" else name] for name in IDENTITY}
    rows = []
    for at, share in enumerate(success, start=1):
        row = dict.fromkeys(MEASURED, 0.0) | {"step": steps * at // EVALUATIONS, "episodes": 10}
        rows.append(identity | row | {"success": float(share), "true_return": 1e3 * share, "queries": 0, "labels": 0})
    record_config(folder, config)
    write_table(folder.curve, table_of(rows), **SETTINGS)
    write_status(folder, _status(RunState.DONE, steps, steps))


def _line(item: str, bound: float, arguments: tuple[str, ...], expected: str) -> Line:
    _answer(arguments, expected)
    told = [_answer(arguments, expected) for _ in range(TURNS)]
    wall, processor = (statistics.median(column) for column in zip(*told, strict=True))
    # A command hardly ever waits for anything but its turn on the processor.
    note = f"busy machine: {processor:.2f} s of processor time" if wall > 1.25 * processor + 0.05 else ""
    return Line(item=item, ours=wall, unit="s", bound=bound, note=note)


def _answer(arguments: tuple[str, ...], expected: str) -> tuple[float, float]:
    """Seconds by the clock, and of processor time, of one run of the program.

    Raises:
        ValueError: it failed, or did not print what was expected.
    """
    before, start = _of_children(), time.perf_counter()
    done = subprocess.run([*PROGRAM, *arguments], capture_output=True, text=True, check=False)
    wall, processor = time.perf_counter() - start, _of_children() - before
    if done.returncode != 0 or expected not in done.stdout:
        raise ValueError(f"rrmctl {' '.join(arguments)} did not say {expected!r}:\n{done.stdout}{done.stderr}")
    return wall, processor


def _of_children() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime
