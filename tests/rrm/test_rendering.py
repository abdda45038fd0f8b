"""Finding OpenGL: only when a picture is wanted, the user's choice first, and one line where there is none."""

import json
import os
import subprocess
import sys

import pytest

from rrm.rendering import renderer

DRAW = """
import json, os, sys
from rrm.envs import make, task
env = make("button-press-image")
env.reset(seed=0)
before = "OpenGL" in sys.modules
picture = env.frame(task("button-press-image").spaces.frames)
from rrm.rendering import renderer
print(json.dumps([before, picture.shape, renderer().backend, int(picture.sum())]))
"""
FIND = "from rrm.rendering import renderer; print(renderer().backend)"


def python(code, env):
    return subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True, check=False)


@pytest.mark.slow
@pytest.mark.sim
@pytest.mark.parametrize(
    "variables",
    [{"MUJOCO_GL": "disabled"}, {"MUJOCO_GL": "disabled", "PYOPENGL_PLATFORM": "glx"}, {}],
)
def test_drawing_in_any_environment(opengl, variables):
    """OpenGL is loaded for the first picture and not before, whatever MuJoCo was imported with; nothing is said of it,
    not even at the end of a process that closes nothing.
    """
    base = {name: value for name, value in os.environ.items() if name not in ("MUJOCO_GL", "PYOPENGL_PLATFORM")}
    done = python(DRAW, base | variables)
    assert (done.returncode, done.stderr) == (0, "")
    before, shape, backend, total = json.loads(done.stdout)
    assert (before, shape, backend) == (False, [64, 64, 3], opengl.backend)
    assert total > 0


def test_a_choice_of_the_user_s_that_does_not_work(opengl):
    """Others are tried then; one that works comes first."""
    found = python(FIND, os.environ | {"MUJOCO_GL": "nonsense"})
    assert (found.returncode, found.stdout.strip()) == (0, opengl.backend)
    code = "import os; from rrm.environ import environment; print(environment(environment())['RRM_MUJOCO_GL'])"
    assert python(code, os.environ | {"MUJOCO_GL": "osmesa"}).stdout.strip() == "osmesa"


def test_none(no_opengl):
    """What was tried, why it failed, and what to install."""
    done = python(FIND, no_opengl)
    assert done.returncode == 1
    said = done.stderr.strip().splitlines()[-1]
    for part in ("rrm.errors.RenderingError: nothing here draws", "egl: ", "osmesa: ", "apt-get install libegl1"):
        assert part in said


def test_it_is_looked_for_once(opengl, monkeypatch):
    """A process that has found one starts no further trial."""
    monkeypatch.setattr(subprocess, "run", None)
    assert renderer() is opengl


@pytest.mark.slow
@pytest.mark.sim
def test_simulating_needs_none(no_opengl):
    """A task with a camera is stepped where nothing draws, and asking for a picture is refused with that line."""
    code = """
from rrm.envs import make, task
from rrm.errors import RenderingError
env = make("button-press-image")
env.reset(seed=0)
env.step(env.action_space.sample())
try:
    env.frame(task("button-press-image").spaces.frames)
except RenderingError as error:
    print(error)
"""
    done = python(code, no_opengl)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("nothing here draws pictures with OpenGL")
