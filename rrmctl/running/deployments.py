"""Deployments that people ask for: one policy of a run at one simulated workplace, and what came of its episodes."""

from __future__ import annotations

import contextlib
import hashlib
import json
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self, cast

import numpy as np

from rrm.envs.tasks import require
from rrm.errors import ConfigError, EpisodesError, NumericalError, RobotError
from rrm.robot.config import RigConfig
from rrm.robot.deployment import Episode, rules_of
from rrm.robot.record import Record
from rrm.training.kinds import kept_networks
from rrmctl.errors import Exit, UserError
from rrmctl.running.config_file import load_config, load_run
from rrmctl.stats.agreement import share
from rrmctl.store.files import (
    PATIENCE_S,
    DamagedError,
    locked,
    read_bytes,
    remove_leftovers,
    storing,
    unreadable,
)
from rrmctl.store.layout import Layout, RunFolder
from rrmctl.store.status import RunState, run_status
from rrmctl.store.sweeps import readable_sweeps

if TYPE_CHECKING:
    from rrm.training.kinds import DeploymentConfig
    from rrm.training.run_config import RunConfig


@dataclass(frozen=True)
class Deployment:
    """One policy at one workplace. Its episodes are kept in a file of their own in the run's folder."""

    folder: RunFolder
    config: RunConfig
    step: int  #: of the environment, at which the policy was kept
    rig: RigConfig
    networks: Path
    source: str  #: digest of all that its episodes follow from

    @classmethod
    def of(cls, folder: RunFolder, checkpoint: int | None, settings: Mapping[str, Any]) -> Self:
        """The policy that a run has kept at a step (None: at its end), at its own rig but for some settings.

        Raises UserError or RrmError where there is no such policy, or an arm has no use for it.
        """
        config = load_run(folder)
        rules_of(config.task)
        if config.action_repeat > 1:
            raise ConfigError(f"run {folder.id} has action_repeat {config.action_repeat}; an arm is told at every step")
        rig = own_rig(folder).model_copy(update=settings)
        step, networks = kept_policy(folder, config.steps, checkpoint)
        content = {
            "networks": hashlib.sha256(read_bytes(networks) or b"").hexdigest(),  # whoever plays says that it is gone
            "rig": rig.model_dump(mode="json", exclude_defaults=True), "seed": config.seed,
            "horizon": config.episode_steps,
        }  # fmt: skip
        source = hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
        return cls(folder, config, step, rig, networks, source)

    @property
    def file(self) -> Path:
        """The record of its episodes."""
        return self.folder.deployments / f"{self.step}-{self.source[:8]}.parquet"

    def episodes(self, count: int, note: Callable[[str], None]) -> Generator[Episode, None, None]:
        """So many from the first on: those that are there, then the others as they are played; each is durable when it
        comes. To be closed, which stops the arm.

        Raises UserError or RrmError where it cannot go on; what is played stays.
        """
        there = _record(self.file, self.source).of(self.step)[:count]
        if there:
            note(f"{len(there)} of {count} episodes are there: {self.file}")
        yield from there
        if len(there) < count:
            require(self.config.spec())
            busy = UserError(
                f"another process deploys step {self.step} of run {self.folder.id} at this workplace",
                "wait for it: what it plays is kept, and the same command goes on from there",
            )
            with locked(self.file.with_suffix(".lock"), PATIENCE_S, busy):
                remove_leftovers(self.folder.deployments)
                record = _record(self.file, self.source)
                yield from record.of(self.step)[len(there) : count]
                yield from self._played(record, count, note)

    def _played(self, record: Record, count: int, note: Callable[[str], None]) -> Iterator[Episode]:
        from rrm.training.deployments import Laboratory

        if (first := len(record.of(self.step))) >= count:
            return
        note("the cameras are calibrated, then the arm moves")
        playing = Laboratory(self.rig).play(self.config, self.networks, first, count, lambda: False)
        try:
            with contextlib.closing(playing):
                for episode in playing:
                    with storing(self.file):
                        record.add(self.step, episode)
                    yield episode
        except (RobotError, NumericalError) as error:
            failure = UserError(str(error), "what was played before stays; the same command goes on")
            failure.code = Exit.FAILED
            raise failure from error


def own_rig(folder: RunFolder) -> RigConfig:
    """The workplace at which its sweep deploys a run, where that is one and can be read; else the usual one. What a run
    is does not depend on it, so that its own configuration does not tell.
    """
    layout, rigs = Layout(folder.results), []
    for job in (job for sweep in readable_sweeps(layout)[0] for job in sweep.deployments):
        if folder.id in job.requires:
            with contextlib.suppress(UserError):  # what is wrong with another run is told where that is asked for
                rigs.append(cast("DeploymentConfig", load_config(layout.run(job.id))).rig)
    return rigs[0] if rigs and all(rig == rigs[0] for rig in rigs) else RigConfig()


def kept(folder: RunFolder) -> list[int]:
    """The environment steps before its end whose networks a run has kept, rising."""
    return sorted(int(path.stem) for path in folder.networks.glob("*.safetensors") if path.stem.isdecimal())


def kept_policy(folder: RunFolder, steps: int, checkpoint: int | None) -> tuple[int, Path]:
    """The step of a policy that a run of so many steps has kept (None: its end), and the file with its networks.

    Raises UserError where there is none, with those that there are.
    """
    state, step, known = run_status(folder).state, checkpoint or steps, kept(folder)
    if state is RunState.DONE:
        known.append(steps)
    if step not in known:
        lacking = f"has kept no networks of step {step}" if checkpoint else f"is {state}"
        there = f"--checkpoint takes {', '.join(map(str, known))}" if known else "it has kept none so far"
        raise UserError(f"run {folder.id} {lacking}", there)
    return step, folder.path / kept_networks(step, steps)


def deployed(folder: RunFolder) -> list[dict[str, Any]]:
    """What was deployed of a run, or by it: of every policy in every record what its episodes are worth.

    Raises DamagedError where a record is damaged.
    """
    return [
        {"step": step, **worth(episodes), "file": str(path.relative_to(folder.path))}
        for path in (folder.episodes, *sorted(folder.deployments.glob("*.parquet")))
        for step, episodes in sorted(_record(path).episodes.items())
    ]


def worth(episodes: Sequence[Episode]) -> dict[str, Any]:
    """What episodes of a policy are worth together, its success with a 95 % interval."""
    success = share([episode.success for episode in episodes])
    total, seen, total_seen = (
        float(np.mean([getattr(episode, name) for episode in episodes]))
        for name in ("total", "success_seen", "total_seen")
    )
    return {
        "episodes": len(episodes), "success": float(success.estimate), "success_low": float(success.low),
        "success_high": float(success.high), "return": total, "success_seen": seen, "return_seen": total_seen,
        "lost": sum(bool(episode.lost) for episode in episodes),
        "breakdowns": sum(episode.breakdowns for episode in episodes),
    }  # fmt: skip


def _record(path: Path, source: str | None = None) -> Record:
    try:
        return Record.read(path, source)
    except EpisodesError as error:
        raise DamagedError(str(error), "move it away: what it holds can be played again") from error
    except OSError as error:
        raise unreadable(path, error) from error
