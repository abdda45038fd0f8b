"""The tasks, what of their state each one reveals, and their environments. No simulator is imported here.

`make(name)` gives a bare environment. For `gymnasium.make("rrm/<name>-v0")`, call `register()` first; where gymnasium
is loaded already, importing this package does so.
"""

import sys

from rrm.envs.spaces import FrameSpace, Spaces
from rrm.envs.tasks import TASKS, Task, make, task

__all__ = ["TASKS", "FrameSpace", "Spaces", "Task", "make", "register", "task"]


def register() -> None:
    """Put every task into gymnasium's registry, as `rrm/<name>-v0`; once is enough, again does no harm."""
    import gymnasium

    for entry in TASKS.values():
        if entry.env_id not in gymnasium.registry:
            # No `max_episode_steps`: the environments keep their time limit themselves, as part of their saved state.
            kwargs = {**entry.kwargs, "horizon": entry.horizon}
            gymnasium.register(entry.env_id, entry_point=entry.entry_point, kwargs=kwargs)


if "gymnasium" in sys.modules:  # planning must not pay for importing it, and need not where it is there
    register()
