"""What all tests share: one torch thread, no renderer, no trace in a home, and no deadlines, whatever the load."""

import os
import signal
import tempfile

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("MUJOCO_GL", "disabled")  # read when mujoco is first imported
os.environ["XDG_STATE_HOME"] = tempfile.mkdtemp()  # what code was run is kept there

import hypothesis
import pytest

from rrm.errors import RenderingError
from rrm.rendering import renderer

signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell has what it puts in the background ignore it

hypothesis.settings.register_profile("unhurried", deadline=None)
hypothesis.settings.load_profile("unhurried")


@pytest.fixture(scope="session")
def opengl():
    """For tests that draw: skipped, with the reason, where nothing does and nobody said that it must."""
    try:
        return renderer()
    except RenderingError as error:
        (pytest.fail if "opengl" in os.environ.get("RRMCTL_TESTS_NEED", "") else pytest.skip)(str(error))


@pytest.fixture
def no_opengl(tmp_path):
    """An environment in which no process finds OpenGL: what bears its libraries' names is empty, and no display."""
    hidden = tmp_path / "hidden"
    hidden.mkdir()
    for library in ("EGL.so", "EGL.so.1", "OSMesa.so", "OSMesa.so.6", "OSMesa.so.8"):
        (hidden / f"lib{library}").touch()
    displays = ("DISPLAY", "WAYLAND_DISPLAY", "PYOPENGL_PLATFORM")
    return {name: value for name, value in os.environ.items() if name not in displays} | {
        "LD_LIBRARY_PATH": str(hidden), "MUJOCO_GL": "disabled"
    }  # fmt: skip
