"""Our tasks in gymnasium's registry, so that `gymnasium.make("rrm/button-press-v0")` works."""

from __future__ import annotations

import gymnasium

from rrm.envs.tasks import TASKS


def register() -> None:
    """Register every task under its `env_id`; once is enough, again does no harm."""
    for task in TASKS.values():
        if task.env_id not in gymnasium.registry:
            # No `max_episode_steps`: the environments keep their time limit themselves, as part of their saved state.
            gymnasium.register(
                task.env_id, entry_point=task.entry_point, kwargs={**task.kwargs, "horizon": task.horizon}
            )
