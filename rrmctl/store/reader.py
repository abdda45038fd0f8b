"""Reading the store, at any time, while any number of workers write to it. Nothing is skipped silently."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from pydantic import StrictInt, StrictStr

from rrm.errors import nearest
from rrm.files import open_regular
from rrmctl.commands import rrmctl
from rrmctl.errors import UserError, check_known
from rrmctl.store.files import DamagedError, StorageError
from rrmctl.store.layout import Layout, RunFolder
from rrmctl.store.owner import is_owned
from rrmctl.store.records import read_json, validated
from rrmctl.store.status import ErrorKind, RunError, RunState, Status, read_status
from rrmctl.store.sweeps import Job, SweepRecord, read_sweeps


def run_status(folder: RunFolder) -> Status:
    """Where the run stands now: one that says it is running while nobody owns it is interrupted.

    A status file that is damaged, or cannot be read now, gives the state `unreadable` with the reason.

    Raises:
        VersionError: it is of another schema version.
    """
    try:
        status = read_status(folder)
        if status.state is RunState.RUNNING and not is_owned(folder):
            return dataclasses.replace(status, state=RunState.INTERRUPTED)
    except (DamagedError, StorageError) as error:
        problem = RunError(kind=ErrorKind.STORAGE, type=type(error).__name__, message=str(error))
        return Status(state=RunState.UNREADABLE, error=problem)
    return status


def statuses(layout: Layout, jobs: Iterable[Job]) -> dict[str, Status]:
    """Status of every run named by `jobs`, by id. Ten thousand take well under a second.

    A run that is not done while one that it needs, and that is named as well, has failed is blocked, for its reason.
    """
    requires = {job.id: job.requires for job in jobs}
    states = {run: run_status(layout.run(run)) for run in requires}

    def look(run: str, above: frozenset[str] = frozenset()) -> Status:
        if states[run].state in _WAITING:
            # Records that were put together by hand may need each other in a circle.
            for needed in (needed for needed in requires[run] if needed in states and needed not in above):
                cause = look(needed, above | {run})
                if cause.state in (RunState.FAILED, RunState.BLOCKED):
                    error = blocked_by(needed, cause.error)
                    states[run] = dataclasses.replace(states[run], state=RunState.BLOCKED, error=error)
                    break
        return states[run]

    return {run: look(run) for run in requires}


_WAITING = (RunState.QUEUED, RunState.INTERRUPTED, RunState.WAITING)


def blocked_by(run: str, error: RunError | None) -> RunError:
    """What keeps a run from starting: the failure of another, which it needs."""
    if error is not None and error.kind is ErrorKind.BLOCKED:
        return error  # the first cause says it all
    reason = f"run {run}, which it needs, failed: {error or 'no reason was recorded'}"
    return RunError(kind=ErrorKind.BLOCKED, type="Blocked", message=reason)


#: What to do about a configuration that is not what it should be.
CONFIG_HINT = "run its experiment again: `rrmctl run NAME` writes it anew"


@dataclass(frozen=True)
class _Config:
    """What the program itself reads of a configuration; the rest is checked when the run starts."""

    id: StrictStr
    cell: StrictStr
    profile: StrictStr
    task: StrictStr
    method: StrictStr
    precision: StrictStr
    config_version: StrictInt
    seed: StrictInt
    steps: StrictInt
    threads: StrictInt


def read_config(folder: RunFolder) -> dict[str, Any]:
    """The run's `config.json`.

    Raises:
        DamagedError: there is none, it is damaged, or lacks what every configuration has.
        StorageError: it cannot be read now.
    """
    config = read_json(folder.config, CONFIG_HINT)
    if config is None:
        raise DamagedError(f"{folder.config} is missing", CONFIG_HINT)
    validated(_Config, config, folder.config, CONFIG_HINT)
    return config


def log_tail(folder: RunFolder, lines: int = 15) -> list[str]:
    """The last lines of a run's log; none where it has not started, and why where it cannot be read."""
    try:
        with open_regular(folder.log) as file:
            file.seek(max(0, file.seek(0, os.SEEK_END) - 400 * lines))
            return file.read().decode(errors="replace").splitlines()[-lines:]
    except (FileNotFoundError, NotADirectoryError):
        return []
    except OSError as error:
        return [f"{folder.log} cannot be read: {error.strerror}"]


def find_sweeps(layout: Layout, experiment: str) -> list[SweepRecord]:
    """The variants of an experiment that were run here.

    Raises:
        UserError: none was; the message lists what is there.
    """
    sweeps = read_sweeps(layout, experiment)
    if not sweeps:
        raise never_run(layout, experiment)
    return sweeps


def never_run(layout: Layout, *experiments: str) -> UserError:
    """What to say where the store holds no run of the first of these, or none at all."""
    known = layout.experiments()
    if not known:
        start = rrmctl("run", "quickstart", results=layout.root)
        return UserError(f"{layout.root} holds no experiment yet", f"start one, e.g. `{start}`")
    near = nearest(experiments[0], known)
    start = "" if near else "; `rrmctl list` names what there is to run"
    return UserError(f'{layout.root} holds no runs of "{experiments[0]}"{near}', f"it holds: {', '.join(known)}{start}")


def chosen_experiments(layout: Layout, asked: Sequence[str]) -> list[str]:
    """The experiments that are asked for, each once; all of the store where none is.

    Raises:
        UserError: the store holds no run of one, or none at all.
    """
    known = layout.experiments()
    unknown = [name for name in asked if name not in known]
    if unknown or not known:
        raise never_run(layout, *unknown)
    return list(dict.fromkeys(asked)) or known


def check_profile(profile: str | None, present: Iterable[str]) -> None:
    """Refuse a profile of which there are no runs; None asks for none.

    Raises:
        UserError: with the nearest that there is.
    """
    if profile is not None:
        check_known(profile, sorted(set(present)), f'no runs of profile "{profile}"', "there are runs of")


def find_run(layout: Layout, prefix: str) -> RunFolder:
    """The folder of the one run whose id starts with `prefix`.

    Raises:
        UserError: none does, or several do, or `prefix` is empty.
    """
    if not prefix:
        raise UserError("no run was named", f"give its id or the first digits of it; {_ids(layout)}")
    matches = [run for run in layout.run_ids() if run.startswith(prefix)]
    if len(matches) == 1:
        return layout.run(matches[0])
    if not matches:
        raise UserError(f"no run in {layout.root} starts with {prefix!r}", _ids(layout))
    shown = ", ".join(matches[:8]) + (", ..." if len(matches) > 8 else "")
    raise UserError(f"{prefix!r} stands for {len(matches)} runs: {shown}", "give more digits")


def _ids(layout: Layout) -> str:
    return f"ids are the names of the folders in {layout.root / 'runs'}"
