"""A test for every task of the table, marked with what it needs."""

import pytest

from rrm.envs import TASKS
from tests.robot import robot

_NEEDS = {"toy": (), "toy-image": (), "panda": robot}

every_task = pytest.mark.parametrize(
    "name", [pytest.param(task.name, marks=_NEEDS.get(task.suite, pytest.mark.sim)) for task in TASKS.values()]
)
