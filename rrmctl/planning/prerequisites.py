"""What a run needs before it can begin: an expert, its demonstrations, and the prior that is trained on them.

The expert is the oracle's run of seed 0, and all seeds of all methods on a task share one prior, as in the paper. The
chain is configured by the profile and by the section `imitation` of a run's settings, by nothing else: two experiments
that differ in their feedback share it.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from rrm.config import AIRL, IMITATION
from rrm.files import place
from rrm.training.kinds import DemosConfig
from rrm.training.run_config import RunConfig
from rrmctl.planning.layering import profile_layers
from rrmctl.planning.settings import resolve

if TYPE_CHECKING:
    from rrm.config import ImitationConfig

Config = RunConfig | DemosConfig


@dataclass(frozen=True)
class Supplied:
    """A run's configuration with what it needs filled in."""

    config: RunConfig
    needed: tuple[Config, ...]  #: each before those that need it


def supply(config: RunConfig, scale: str, folder: Path) -> Supplied:
    """Name the runs that this one needs.

    Args:
        config: of a cell, as its settings say, not made canonical yet.
        scale: the profile's name.
        folder: where `imitation.demos` is named from.

    Raises:
        UserError: the profile's settings for a run of the chain cannot be run together.
        RrmError: `imitation.demos` cannot be read.
    """
    if config.reward.prior != IMITATION and not config.from_demonstrations:
        return Supplied(config, ())
    imitation, needed = _demonstrated(config, scale, folder)
    if config.from_demonstrations:
        return Supplied(config.model_copy(update={"imitation": imitation}), needed)
    prior = _resolved(
        config.task, scale, AIRL, steps=imitation.steps, **{f"imitation.{k}": v for k, v in imitation}
    )  # fmt: skip
    reward = config.reward.model_copy(update={"prior_run": prior.identity})
    return Supplied(config.model_copy(update={"reward": reward}), (*needed, prior))


def _demonstrated(config: RunConfig, scale: str, folder: Path) -> tuple[ImitationConfig, tuple[Config, ...]]:
    """The run's section with its demonstrations named, and the runs that make them where the user gave none."""
    imitation = config.imitation
    if imitation.demos is not None:
        return imitation.model_copy(update={"demos": os.path.realpath(folder / place(imitation.demos))}), ()
    expert = _resolved(config.task, scale, "true")
    demos = DemosConfig(
        profile=scale, task=config.task, expert=expert,
        episodes=imitation.episodes, least_success=imitation.expert_success,
    )  # fmt: skip
    return imitation.model_copy(update={"demos_run": demos.identity}), (expert, demos)


def _resolved(task: str, scale: str, learner: str, **decided: object) -> RunConfig:
    """A run of seed 0 as the profile alone has it."""
    settings = {"task": task, "seed": 0, "profile": scale, "reward.learner": learner, **decided}
    return resolve(profile_layers(scale, task, "known"), f"{learner} on {task}", **settings).canonical()
