"""Runs that no sweep's record asks for any more: superseded ones, and those whose record is gone."""

from __future__ import annotations

import contextlib
import dataclasses
import os
import shutil
from collections.abc import Iterable

from rrm.files import sync_folder
from rrmctl.store.files import storage_error
from rrmctl.store.layout import Layout, RunFolder
from rrmctl.store.locks import PATIENCE_S, locked
from rrmctl.store.owner import lock_free
from rrmctl.store.sweeps import read_sweeps, write_sweep


def unused(layout: Layout) -> list[str]:
    """Ids of the runs below the results root that no record names, sorted.

    Raises:
        UserError: a record is damaged, cannot be read now, or is of another schema version: it may name any run.
    """
    named = {job.id for sweep in read_sweeps(layout) for job in sweep.everything}
    return [run for run in layout.run_ids() if run not in named]


def remove(layout: Layout, runs: Iterable[str]) -> list[str]:
    """Remove those of these runs that are unused still and that no process owns, each as a whole; their ids.

    Records forget what was superseded and is gone. While it works no command records a sweep.

    Raises:
        StorageError: the results folder takes no write.
        UserError: as `unused`.
    """
    with contextlib.ExitStack() as recording_kept_out:
        for experiment in layout.experiments():
            recording_kept_out.enter_context(locked(layout.sweep_lock(experiment)))
        for half in (layout.root / "runs").glob(".*.removed"):  # what was begun by one that was killed
            shutil.rmtree(half)
        gone = [run for run in unused(layout) if run in set(runs) and _remove(layout.run(run))]
        for sweep in read_sweeps(layout):
            left = tuple(job for job in sweep.superseded if job.id not in gone)
            if left != sweep.superseded:
                write_sweep(layout.sweep(sweep.experiment, sweep.variant), dataclasses.replace(sweep, superseded=left))
    return gone


def _remove(run: RunFolder) -> bool:
    """Remove a run's folder, unless a process owns the run. Renamed first: nobody finds half of it."""
    lock = lock_free(run, PATIENCE_S)
    if lock is None:
        return False
    aside = run.path.with_name(f".{run.id}.removed")
    try:
        run.path.rename(aside)
        sync_folder(aside.parent)
        shutil.rmtree(aside)
    except OSError as error:
        raise storage_error(run.path, error, "remove") from error
    finally:
        os.close(lock)
    return True
