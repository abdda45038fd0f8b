"""Deployments of a run's policies at the simulated workplace, and the job that does all those a run has kept."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch

from rrm.errors import EpisodesError
from rrm.robot.deployment import Episode, deploy
from rrm.robot.record import FILE, Record
from rrm.robot.rig import Rig
from rrm.robot.setup import calibration, marked_cube
from rrm.training.build import result_of
from rrm.training.episodes import expert_policy
from rrm.training.kinds import kept_networks
from rrm.types import EvalRow, Floats, Obs

if TYPE_CHECKING:
    from rrm.robot.camera import Camera
    from rrm.robot.config import RigConfig
    from rrm.training.jobs import Monitor
    from rrm.training.kinds import DeploymentConfig
    from rrm.training.run_config import RunConfig

_NAN = float("nan")
_BEAT_S = 0.25


class _StopError(Exception):
    """Not an error: somebody asked for the end in the middle of an episode."""


@dataclass(frozen=True)
class Laboratory:
    """A simulated workplace."""

    rig: RigConfig

    @cached_property
    def cameras(self) -> Mapping[str, Camera]:
        """As calibrated when they are first needed, which takes some seconds."""
        return calibration(self.rig).cameras

    def play(
        self,
        config: RunConfig,
        networks: Path,
        first: int,
        episodes: int,
        stopped: Callable[[], bool],
        *,
        connect: Callable[[RigConfig], Rig] = Rig,
    ) -> Generator[Episode, None, None]:
        """Deploy the policy that a run has left in a file, from the episode of number `first` on. Each follows from the
        run's seed and its number alone. It ends in the middle of one where it is stopped, and the arm stops.

        Raises:
            MissingResultError: the networks are not there.
            RobotError: the workplace breaks down again and again.
            NumericalError: the policy's action is not finite.
        """
        act = expert_policy(config, networks)

        def policy(obs: Floats) -> Floats:
            if stopped():
                raise _StopError
            return act(Obs(obs))

        with contextlib.suppress(_StopError):
            yield from deploy(
                policy, config.task, partial(connect, self.rig), self.cameras, marked_cube(self.rig),
                episodes=episodes, seed=config.seed, first=first, horizon=config.episode_steps,
            )  # fmt: skip


def deploy_kept(config: DeploymentConfig, folder: Path, monitor: Monitor, results: Mapping[str, Path]) -> bool:
    """Have the policies that a run has kept play what is not in `folder/episodes.parquet` yet.

    True when all is played; False when it was told to stop, and will go on with the episode under way.
    """
    torch.set_num_threads(config.threads)
    path, due = folder / FILE, config.episodes
    try:
        record = Record.read(path, config.identity)
    except EpisodesError as error:
        with monitor.writing():
            path.replace(aside := path.with_suffix(".corrupt"))
        monitor.note(f"{error}: set aside as {aside.name}, and played again")
        record = Record.read(path, config.identity)
    steps = [step for step in config.checkpoints if len(record.of(step)) < due]
    played = [step for step in config.checkpoints if step not in steps]
    # When each was over is not kept; by the last all of that time had passed.
    monitor.restored([
        summary(step, record.of(step), record.wall_s if step == played[-1] else _NAN) for step in played
    ])  # fmt: skip
    if not steps:
        return True
    laboratory, began = Laboratory(config.rig), time.monotonic()
    for step in steps:
        before = max((other for other in config.checkpoints if other < step), default=0)
        networks = result_of(results, config.policy.identity, kept_networks(step, config.policy.steps))
        attend = _Attention(monitor, before)
        for episode in laboratory.play(config.policy, networks, len(record.of(step)), due, attend):
            with monitor.writing():
                record.add(step, episode, (now := time.monotonic()) - began)
            began = now
            attend.step = before + (step - before) * (episode.number + 1) // due
        if len(record.of(step)) < due:
            return False
        monitor.row(summary(step, record.of(step), record.wall_s))
    return True


@dataclass
class _Attention:
    """Signs of life, and whether to stop; asked before every action."""

    monitor: Monitor
    step: int  #: of what is done, as if the steps from one policy to the next were its episodes
    beaten: float = 0.0

    def __call__(self) -> bool:
        if (now := time.monotonic()) - self.beaten >= _BEAT_S:
            self.beaten = now
            self.monitor.beat(self.step, _NAN)
        return self.monitor.should_stop()


def summary(step: int, episodes: Sequence[Episode], wall_s: float = _NAN) -> EvalRow:
    """What the policy of a step is worth there. The paper's success and return are by the truth; what the cameras made
    of the same episodes stands among the figures.
    """

    def mean(name: str) -> float:
        return float(np.mean([getattr(episode, name) for episode in episodes]))

    figures = {
        f"deployed_{name}": mean(name) for name in ("success_seen", "total_seen", "views", "markers", "error_px")
    }
    figures |= {f"deployed_{name}": float(sum(getattr(e, name) for e in episodes)) for name in ("held", "breakdowns")}
    figures["deployed_lost"] = float(sum(bool(episode.lost) for episode in episodes))
    unknown = dict.fromkeys(("prior_mean", "residual_mean", "reward_mean", "reward_std", "true_reward_mean"), _NAN)
    return EvalRow(
        step=step, episodes=len(episodes), true_return=mean("total"), success=mean("success"), queries=0, labels=0,
        **unknown, wall_s=wall_s, steps_per_s=_NAN, figures=figures,
    )  # fmt: skip
