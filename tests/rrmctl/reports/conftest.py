import pytest

from rrm.envs import tasks
from rrm.envs.tasks import Task
from rrmctl.reports import published


@pytest.fixture
def robot(monkeypatch):
    """The simulated robot's tasks, as the library may come to know them."""
    for name in published.deployed_tasks():
        spec = Task(name=name, suite="robot", score="success", horizon=50, obs_dim=9, act_dim=3, entry_point="a:B")
        monkeypatch.setitem(tasks.TASKS, name, spec)
