"""Where everything lies below a results root. No other file spells a path.

runs/<id>/                           the files of a run, see `RunFolder`
sweeps/<experiment>/<variant>.json   what `run` was asked for
trials/<experiment>/<variant>.json   the rules of `run --until-decided`
aggregates/<experiment>.parquet      interquartile mean curves
labels/                              what people were asked for no run, and what the server of labels keeps
drivers/                             commands that run them now
slurm/                               job arrays: `<name>.json` and `<name>.sh` of each, and the logs of their tasks

Whatever else lies in these folders (a copy, a note, a system's own files) is nobody's run or sweep and is ignored.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from rrm.errors import nearest
from rrm.files import place
from rrmctl.commands import rrmctl
from rrmctl.errors import UserError, check_known

#: Names that become a file's: no separators, nothing hidden, no way out of the results root.
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,127}")

#: What a run's identity looks like.
RUN_ID = re.compile(r"[0-9a-f]{16}")

#: Files of a run's owners.
_LEASE = re.compile(r"lease(?:-([1-9][0-9]{0,15}))?\.json")


class _Entry:
    """A file or folder of this name in a run's folder; of the class, the name alone."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __get__(self, folder: RunFolder | None, _owner: type[RunFolder]) -> Path:
        return Path(self._name) if folder is None else folder.path / self._name


@dataclass(frozen=True)
class RunFolder:
    """The files of one run."""

    path: Path

    config = _Entry("config.json")  #: the full configuration, and id, cell and method; written before the run starts
    provenance = _Entry("provenance.json")  #: versions, machine, code and environment; what changed at resumptions
    curve = _Entry("curve.parquet")  #: one row per evaluation; replaced after each
    status = _Entry("status.json")  #: state, attempt, progress, error; replaced every few seconds
    log = _Entry("log.txt")  #: everything the worker printed; only ever appended to
    lock = _Entry("lock")  #: empty; what counts is who holds it
    guard = _Entry("guard")  #: empty; held for the moment of a write, see `rrmctl.store.lease`
    lease = _Entry("lease.json")  #: an owner's signs of life, in earlier versions; now `lease_of` its number
    checkpoint = _Entry("checkpoint")  #: the trainer's own folder, gone when the run is done
    model = _Entry("model.safetensors")  #: the final networks
    demos = _Entry("demos.safetensors")  #: the demonstrations, of a run that collects them
    film = _Entry("demos.safetensors.frames")  #: their pictures, where an agent sees any
    queries = _Entry("queries")  #: what is put before people, see `rrm.teachers.published`
    labels = _Entry("labels.parquet")  #: what they answered, see `rrm.teachers.labels`; training anew keeps it
    gradients = _Entry("gradients.parquet")  #: norms, of a run that fine-tunes an imitation reward
    networks = _Entry("networks")  #: those of steps before the end that are to be deployed
    episodes = _Entry("episodes.parquet")  #: what came of them at the workplace, of a job that deploys them all
    deployments = _Entry("deployments")  #: and of `rrmctl deploy`, a file for each policy and workplace

    @property
    def id(self) -> str:
        """The run's identity."""
        return self.path.name

    def lease_of(self, number: int) -> Path:
        """Signs of life of the run's owner of this number, from 1; empty once it has given the run back."""
        return self.path / f"lease-{number}.json" if number else self.lease

    def leases(self) -> list[int]:
        """Numbers of the owners whose files are there, in no order. Raises OSError where the folder cannot be read."""
        try:
            with os.scandir(self.path) as entries:
                found = [_LEASE.fullmatch(entry.name) for entry in entries]
        except (FileNotFoundError, NotADirectoryError):
            return []
        return [int(match[1] or 0) for match in found if match]

    @property
    def results(self) -> Path:
        """The results root that it lies in."""
        return self.path.parent.parent

    def trained(self) -> tuple[Path, ...]:
        """What training leaves, to be removed when a run starts from nothing."""
        return (
            self.curve,
            self.provenance,
            self.checkpoint,
            self.model,
            self.demos,
            self.film,
            self.gradients,
            self.queries,
            self.networks,
            self.episodes,
            self.deployments,
        )


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

    @property
    def extra_labels(self) -> Path:
        """The answers of people that belong to no run: practice, and what everybody is asked."""
        return self.root / "labels" / "extra.parquet"

    def extra_queries(self, task: str) -> Path:
        """The folder of those queries, of a task: sessions as in a run's (`rrm.teachers.published`)."""
        return self.root / "labels" / _checked("task", task)

    @property
    def labels_lock(self) -> Path:
        """Held by whoever writes labels, those in the runs' folders included."""
        return self.root / "labels" / "lock"

    @property
    def label_keys(self) -> Path:
        """By what a page is known again: digests, none of which opens anything."""
        return self.root / "labels" / "keys.json"

    @property
    def clips(self) -> Path:
        """Pictures while they are shown; nothing else is kept there."""
        return self.root / "labels" / "clips"

    @property
    def slurm(self) -> Path:
        """The folder of what was submitted to Slurm, and of the logs of its tasks."""
        return self.root / "slurm"

    def submission(self, name: str) -> Path:
        """The record of a job array; its script lies beside it."""
        return self.slurm / f"{_checked('job', name)}.json"

    def submissions(self) -> list[str]:
        """The names of all job arrays, sorted."""
        return [name[: -len(".json")] for name in _names(self.slurm, lambda entry: entry.suffix == ".json")]

    @property
    def slurm_lock(self) -> Path:
        """Held by whoever submits, from its look at the queue to its end."""
        return self.slurm / ".lock"

    @property
    def drivers(self) -> Path:
        """The folder of commands that see runs to their end, see `rrmctl.store.drivers`."""
        return self.root / "drivers"

    def _sweeps(self, experiment: str) -> Path:
        return self.root / "sweeps" / _checked("experiment", experiment)


def new_results(results: str | Path) -> Layout:
    """The layout of a results root, whether or not it exists. Raises UserError where it is a file."""
    root = place(results)
    if root.exists() and not root.is_dir():
        raise UserError(f"{root} is a file, not a folder", "name a folder with --results; the default is results")
    return Layout(root)


def open_results(results: str | Path) -> Layout:
    """The layout of an existing results root. Raises UserError where there is no such folder."""
    layout = new_results(results)
    if not layout.root.is_dir():
        begin = rrmctl("run", "quickstart", results=layout.root)
        raise UserError(f"there is no results folder {layout.root}", f"`{begin}` makes one; --results names another")
    return layout


def never_run(layout: Layout, *experiments: str) -> UserError:
    """What to say where the store holds no run of the first of these, or none at all."""
    present = layout.experiments()
    if not present:
        start = rrmctl("run", "quickstart", results=layout.root)
        return UserError(f"{layout.root} holds no experiment yet", f"start one, e.g. `{start}`")
    near = nearest(experiments[0], present)
    start = "" if near else "; `rrmctl list` names what there is to run"
    hint = f"it holds: {', '.join(present)}{start}"
    return UserError(f'{layout.root} holds no runs of "{experiments[0]}"{near}', hint)


def chosen_experiments(layout: Layout, asked: Sequence[str]) -> list[str]:
    """The experiments that are asked for, each once; all of the store where none is. UserError where one never ran."""
    present = layout.experiments()
    unknown = [name for name in asked if name not in present]
    if unknown or not present:
        raise never_run(layout, *unknown)
    return list(dict.fromkeys(asked)) or present


def check_profile(profile: str | None, present: Iterable[str]) -> None:
    """Refuse a profile of which there are no runs, with the nearest that there is; None asks for none."""
    if profile is not None:
        check_known(profile, sorted(set(present)), f'no runs of profile "{profile}"', "there are runs of")


def find_run(layout: Layout, prefix: str) -> RunFolder:
    """The folder of the one run whose id starts with `prefix`; UserError where none or several do, or it is empty."""
    ids = f"ids are the names of the folders in {layout.root / 'runs'}"
    if not prefix:
        raise UserError("no run was named", f"give its id or the first digits of it; {ids}")
    matches = [run for run in layout.run_ids() if run.startswith(prefix)]
    if len(matches) == 1:
        return layout.run(matches[0])
    if not matches:
        raise UserError(f"no run in {layout.root} starts with {prefix!r}", ids)
    shown = ", ".join(matches[:8]) + (", ..." if len(matches) > 8 else "")
    raise UserError(f"{prefix!r} stands for {len(matches)} runs: {shown}", "give more digits")


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
