import pytest

from rrm.envs import tasks
from rrm.envs.tasks import Spaces, Task
from rrmctl.reports import published


@pytest.fixture
def robot(monkeypatch):
    """The simulated robot's tasks, as the library may come to know them."""
    for name in published.deployed_tasks():
        spec = Task(name=name, suite="robot", score="success", horizon=50, spaces=Spaces(9, 3), entry_point="a:B")
        monkeypatch.setitem(tasks.TASKS, name, spec)
