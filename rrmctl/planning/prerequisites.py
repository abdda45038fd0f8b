"""What a run needs before it can begin: an expert, its demonstrations, and the prior that is trained on them; and what
is done with it afterwards.

The expert is the oracle's run of seed 0, and all seeds of all methods on a task share one prior, as in the paper. The
chain is configured by the profile and by the section `imitation` of a run's settings, and looks, acts and learns where
the run does (camera, action repeat, what varies, device); by nothing else: two experiments that differ in their
feedback share it.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

from rrm.config import AIRL, IMITATION, DrqConfig
from rrm.errors import ConfigError
from rrm.files import place
from rrm.robot.config import DeployConfig
from rrm.training.kinds import DemosConfig, DeploymentConfig
from rrm.training.run_config import RunConfig
from rrmctl.planning.grid import profile_layers
from rrmctl.planning.settings import resolve

Config = RunConfig | DemosConfig | DeploymentConfig

#: Settings that name a file without code, whose place is told from a folder.
FILES = ("imitation.demos", "teacher.labels")


def taught(config: RunConfig, experiment: str, folders: Mapping[str, Path]) -> RunConfig:
    """With what its teacher must know of the plan: the study that people take part in, and where their answers are.

    Args: folders: those that `FILES` are named from.
    """
    teacher = config.teacher
    if teacher is None or teacher.kind == "scripted":
        return config
    changes: dict[str, str] = {"study": teacher.study or experiment}
    if teacher.labels is not None:
        changes["labels"] = os.path.realpath(folders["teacher.labels"] / place(teacher.labels))
    return config.model_copy(update={"teacher": teacher.model_copy(update=changes)})


def supply(config: RunConfig, scale: str, folder: Path) -> tuple[RunConfig, tuple[Config, ...]]:
    """Name the runs that this one needs.

    Args:
        config: of a cell, as its settings say, not made canonical yet.
        scale: the profile's name.
        folder: where `imitation.demos` is named from.

    Returns:
        The configuration with what it needs filled in, and that: each before those that need it.

    Raises:
        UserError: the profile's settings for a run of the chain cannot be run together.
        ConfigError: the agent is to begin with an encoder of another shape.
        RrmError: `imitation.demos` cannot be read.
    """
    if config.reward.prior != IMITATION and not (config.from_demonstrations or config.borrows_encoder):
        return config, ()
    imitation = config.imitation
    world: dict[str, object] = {"action_repeat": config.action_repeat, "device": config.device}
    for part in ("camera", "env"):
        settings = getattr(config, part).model_dump(exclude_defaults=True)
        world |= {f"{part}.{name}": value for name, value in settings.items()}
    needed: tuple[Config, ...] = ()
    if imitation.demos is not None:
        path = os.path.realpath(folder / place(imitation.demos))
        imitation = imitation.model_copy(update={"demos": path})
    else:
        expert = _resolved(config.spec().expert or config.task, scale, "true", **world)
        demos = DemosConfig(
            profile=scale, task=config.task, expert=expert,
            episodes=imitation.episodes, least_success=imitation.expert_success,
            camera=config.canonical().camera if config.sees_frames else None,
        )  # fmt: skip
        imitation, needed = imitation.model_copy(update={"demos_run": demos.identity}), (expert, demos)
    if config.from_demonstrations:
        return config.model_copy(update={"imitation": imitation}), needed
    section = {f"imitation.{name}": value for name, value in imitation}
    prior = _resolved(config.task, scale, AIRL, steps=imitation.steps, **world, **section)
    own, lent = (each.agent.looks if isinstance(each.agent, DrqConfig) else "none" for each in (config, prior))
    if config.borrows_encoder and own != lent:  # the run would refuse it, after the chain
        raise ConfigError(
            f"agent.encoder: that of the prior {IMITATION} has {lent} in this profile, this run's agent has {own}: set "
            'agent.encoder = "fresh", or leave them as they are'
        )
    changes: dict[str, object] = {}
    if config.reward.prior == IMITATION:
        changes["reward"] = config.reward.model_copy(update={"prior_run": prior.identity})
    if config.borrows_encoder:
        changes["agent"] = config.agent.model_copy(update={"encoder_run": prior.identity})
    return config.model_copy(update=changes), (*needed, prior)


def deployment_of(policy: RunConfig, settings: DeployConfig) -> DeploymentConfig:
    """What is done with the networks that a run keeps."""
    return DeploymentConfig(
        profile=policy.profile, task=policy.task, seed=policy.seed, threads=policy.threads, policy=policy,
        episodes=settings.episodes, rig=settings.rig, precision=policy.precision,
    )  # fmt: skip


def _resolved(task: str, scale: str, learner: str, **decided: object) -> RunConfig:
    """A run of seed 0 as the profile alone has it."""
    settings = {"task": task, "seed": 0, "profile": scale, "reward.learner": learner, **decided}
    return resolve(profile_layers(scale, task, "known"), f"{learner} on {task}", **settings).canonical()
