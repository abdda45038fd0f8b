"""Demonstrations for people, played by a finished run or by a scripted policy."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from rrmctl.errors import UserError
from rrmctl.running.config_file import load_run
from rrmctl.store.status import RunState, run_status

if TYPE_CHECKING:
    from rrm.imitation.demos import Demonstrations
    from rrmctl.store.layout import RunFolder


def play_run(folder: RunFolder, episodes: int, seed: int, least_success: float) -> Demonstrations:
    """Episodes of a finished run's deterministic policy.

    Raises:
        UserError: the run is not done, or trains no policy.
        RrmError: its networks are not there, or its policy succeeds too rarely.
    """
    from rrm.buffers.frames import Frames
    from rrm.training.episodes import expert_policy

    state = run_status(folder).state
    if state is not RunState.DONE:
        raise UserError(f"run {folder.id} is {state}", "demonstrations come from a run that is done")
    config = load_run(folder)
    source = {"source": "expert", "expert": config.identity, "expert_steps": config.steps, "method": config.method}
    options = {"seed": seed, "least_success": least_success, "source": source, "horizon": config.horizon}
    options["ranges"] = config.env.ranges()
    frames = None if config.spaces.frames is None else Frames(config.spaces.frames)
    policy = expert_policy(config, folder.model)
    return _play(config.task, policy, episodes, frames=frames, repeat=config.action_repeat, **options)


def play_script(task: str, episodes: int, seed: int, least_success: float) -> Demonstrations:
    """Episodes of the policy that Meta-World ships. Raises RrmError where there is none, or it succeeds too rarely."""
    from rrm.envs.metaworld import scripted_policy

    policy, source = scripted_policy(task), {"source": "scripted"}
    options = {"seed": seed, "least_success": least_success, "source": source}
    return _play(task, lambda obs: policy(obs.state), episodes, **options)


def _play(task: str, policy: Any, episodes: int, **options: Any) -> Demonstrations:
    from rrm.training.episodes import demonstrate

    demos = demonstrate(task, policy, episodes, **options)
    assert demos is not None  # nobody asked it to stop
    return demos


def summary(path: Path) -> dict[str, Any]:
    """What is known of the demonstrations in a file. Raises RrmError where it holds none."""
    from rrm.imitation.demos import Demonstrations

    return Demonstrations.load(path).summary()
