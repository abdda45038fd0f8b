"""Where everything lies below a results root. No other file spells a path.

runs/<id>/config.json         the full configuration, and the run's id, cell and method
runs/<id>/provenance.json     versions, machine, code and environment it ran with; what changed at each resumption
runs/<id>/curve.parquet       one row per evaluation
runs/<id>/status.json         state, attempt, progress, error
runs/<id>/log.txt             everything the worker printed
runs/<id>/lock, guard, lease.json    who owns the run, see `rrmctl.store.lease` and `owner`
runs/<id>/checkpoint/         the trainer's own, gone when the run is done
runs/<id>/model.safetensors   the final networks
runs/<id>/demos.safetensors   the demonstrations, of a run that collects them
runs/<id>/gradients.parquet   norms of gradients, of a run that fine-tunes an imitation reward
sweeps/<experiment>/<variant>.json   what `run` was asked for
trials/<experiment>/<variant>.json   the rules of `run --until-decided`
aggregates/<experiment>.parquet      interquartile mean curves

Whatever else lies in these folders (a copy, a note, a system's own files) is nobody's run or sweep and is ignored.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from rrmctl.errors import UserError

#: Names that become a file's: no separators, nothing hidden, no way out of the results root.
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,127}")

#: What a run's identity looks like.
RUN_ID = re.compile(r"[0-9a-f]{16}")


@dataclass(frozen=True)
class RunFolder:
    """The files of one run."""

    path: Path

    @property
    def id(self) -> str:
        """The run's identity."""
        return self.path.name

    @property
    def results(self) -> Path:
        """The results root that it lies in."""
        return self.path.parent.parent

    @property
    def config(self) -> Path:
        """Written once, before the run starts."""
        return self.path / "config.json"

    @property
    def provenance(self) -> Path:
        """Written when the run starts, extended when it resumes."""
        return self.path / "provenance.json"

    @property
    def curve(self) -> Path:
        """Replaced after each evaluation."""
        return self.path / "curve.parquet"

    @property
    def status(self) -> Path:
        """Replaced at each change of state and every few seconds in between."""
        return self.path / "status.json"

    @property
    def log(self) -> Path:
        """Only ever appended to."""
        return self.path / "log.txt"

    @property
    def lock(self) -> Path:
        """Empty; what counts is who holds it."""
        return self.path / "lock"

    @property
    def guard(self) -> Path:
        """Empty; held for the moment of a write, see `rrmctl.store.lease`."""
        return self.path / "guard"

    @property
    def lease(self) -> Path:
        """The owner's signs of life."""
        return self.path / "lease.json"

    @property
    def checkpoint(self) -> Path:
        """The trainer's own folder."""
        return self.path / "checkpoint"

    @property
    def model(self) -> Path:
        """Written when training is over."""
        return self.path / "model.safetensors"

    @property
    def demos(self) -> Path:
        """Written when they are all there."""
        return self.path / "demos.safetensors"

    @property
    def gradients(self) -> Path:
        """Replaced with the curve."""
        return self.path / "gradients.parquet"

    def trained(self) -> tuple[Path, ...]:
        """What training leaves, to be removed when a run starts from nothing."""
        return (self.curve, self.provenance, self.checkpoint, self.model, self.demos, self.gradients)


@dataclass(frozen=True)
class Layout:
    """The folders and files below one results root."""

    root: Path

    def run(self, run: str) -> RunFolder:
        """The folder of the run with this id, whether or not it exists."""
        return RunFolder(self.root / "runs" / _checked("run", run))

    def run_ids(self) -> list[str]:
        """Ids of all run folders, sorted. What is not a folder named by sixteen hexadecimal digits is ignored."""
        return _names(self.root / "runs", lambda entry: bool(RUN_ID.fullmatch(entry.name)) and entry.is_dir())

    def sweep(self, experiment: str, variant: str) -> Path:
        """The record of one variant of an experiment."""
        return self._sweeps(experiment) / f"{_checked('variant', variant)}.json"

    def sweep_lock(self, experiment: str) -> Path:
        """Held while a sweep record is read, extended and written back."""
        return self._sweeps(experiment) / ".lock"

    def sweep_files(self, experiment: str) -> list[Path]:
        """The records of all variants of an experiment, sorted; none where it never ran here. Others are ignored."""
        folder = self._sweeps(experiment)
        return [folder / name for name in _names(folder, lambda entry: entry.suffix == ".json" and entry.is_file())]

    def experiments(self) -> list[str]:
        """Experiments with a sweep record, sorted. What is not a folder with an experiment's name is ignored."""
        return _names(self.root / "sweeps", lambda entry: entry.is_dir())

    def trial(self, experiment: str, variant: str) -> Path:
        """The rules of a sequential test of one variant of an experiment."""
        return self.root / "trials" / _checked("experiment", experiment) / f"{_checked('variant', variant)}.json"

    def aggregate(self, experiment: str) -> Path:
        """The interquartile mean curves of an experiment."""
        return self.root / "aggregates" / f"{_checked('experiment', experiment)}.parquet"

    def _sweeps(self, experiment: str) -> Path:
        return self.root / "sweeps" / _checked("experiment", experiment)


def _names(folder: Path, wanted: Callable[[Path], bool]) -> list[str]:
    try:
        with os.scandir(folder) as entries:
            return sorted(entry.name for entry in entries if _NAME.fullmatch(entry.name) and wanted(Path(entry)))
    except (FileNotFoundError, NotADirectoryError):
        return []


def _checked(kind: str, name: str) -> str:
    if not _NAME.fullmatch(name):
        raise UserError(f"{kind} {name!r} cannot name a file", "letters, digits, dots, dashes and underscores, please")
    return name
