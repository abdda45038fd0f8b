"""The prompt for a language model: a line on the task, the environment's source, an instruction (paper, appendix).

The paper's prompt stops there and its answers are transcribed by hand; `skeleton` appends the code that an answer is to
fill in, as the appendix suggests, with what a prior may read and the subset of Python that is admitted.
"""

from __future__ import annotations

from rrm.envs.tasks import Task
from rrm.errors import ConfigError
from rrm.priors.language.source import source_without_reward
from rrm.priors.language.vocabulary import OUTCOMES, TASK_FEATURES
from rrm.priors.step import PriorStep

_METAWORLD = "Here is a Meta-World (built on MuJoCo) task: {}. The robot arm Sawyer is required to {}."
_DMC = "Here is a DM-control (built on MuJoCo) task: {}. The robot {} is required to walk normally."

#: The first part; walker-walk's is the paper's, the others follow it.
_LINES = {
    "button-press": _METAWORLD.format("Button Press", "press a button in front of it"),
    "door-open": _METAWORLD.format("Door Open", "open a door with a revolving joint by its handle"),
    "door-unlock": _METAWORLD.format("Door Unlock", "unlock a door by turning its lock"),
    "sweep-into": _METAWORLD.format("Sweep Into", "sweep a puck on the table into a hole"),
    "window-open": _METAWORLD.format("Window Open", "push a sliding window open by its handle"),
    "walker-walk": _DMC.format("Walker Walk", "Walker"),
    "quadruped-walk": _DMC.format("Quadruped Walk", "Quadruped"),
    "toy-car": "Here is a two-dimensional task: Toy Car. The car is required to drive to a goal quickly, without "
    "coming too close to the obstacles.",
}

_INSTRUCTION = "Please design a reward for this task to enable the agent to achieve the goal."

_SKELETON = '''\
Please fill in this function. It is called once for every step, and returns one number, at best between -1 and 1.

import numpy as np


def reward(step):
    """The reward of one step.

    Before the step, float arrays or numbers:
{before}
{after}    step.first: the state the episode began with, with the same names.
    """
    ...

Use arithmetic, comparisons, if and for over a range of numbers, functions of numpy and math on numbers and small
arrays, and functions of your own above this one. Nothing else can be imported, and there are no methods,
comprehensions, classes or texts.
'''


def make_prompt(task: Task, *, skeleton: bool) -> str:
    """The prompt for this task.

    Args:
        skeleton: end with the code skeleton.

    Raises:
        ConfigError: there is none for the task, or its reward cannot be taken out of its source.
    """
    if task.name not in _LINES:
        raise ConfigError(f"there is no prompt for {task.name}; there is one for: {', '.join(_LINES)}")
    parts = [f"{_LINES[task.name]} The environment code is:", source_without_reward(task).rstrip("\n"), _INSTRUCTION]
    return "\n\n".join([*parts, _skeleton(task)]) if skeleton else "\n\n".join(parts) + "\n"


def _skeleton(task: Task) -> str:
    features = [_described(name) for name in TASK_FEATURES if name in task.features]
    vectors = [
        f"    step.obs: the observation, {task.spaces.obs} numbers.",
        f"    step.act: the action, {task.spaces.act} numbers.",
    ]
    outcomes = [_described(name) for name in OUTCOMES if name in task.outcomes]
    after = "\n".join(["", "    After the step, numbers:", *outcomes, ""]) if outcomes else ""
    return _SKELETON.format(before="\n".join([*features, *vectors]), after=after)


def _described(name: str) -> str:
    return f"    step.{name}: {getattr(PriorStep, name).__doc__}"
