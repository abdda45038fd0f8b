"""Which OpenGL draws off screen here: looked for when the first picture is wanted, as what only simulates needs none.

MuJoCo chooses by the variable MUJOCO_GL while it is imported, and cannot be imported where its choice is missing. So it
is imported with none, what works is tried in processes of their own, and then it chooses again.
"""

from __future__ import annotations

import os
from functools import cache
from typing import NamedTuple

from rrm.environ import WISH, environment, run_python
from rrm.errors import RenderingError

#: Ways to OpenGL, by MuJoCo's names: a driver's or Mesa's without a display, Mesa's in memory, that of a display.
_BACKENDS = ("egl", "osmesa", "glfw")

_PROBE = """
import mujoco
model = mujoco.MjModel.from_xml_string("<mujoco><worldbody><geom size='1'/></worldbody></mujoco>")
data, renderer = mujoco.MjData(model), mujoco.Renderer(model, 8, 8)
renderer.update_scene(data)
renderer.render()
from OpenGL import GL
print(*(GL.glGetString(name).decode() for name in (GL.GL_RENDERER, GL.GL_VERSION)), sep=", OpenGL ")
renderer.close()
"""

#: What brings one to Debian and its kin.
INSTALL = "apt-get install libegl1 libegl-mesa0 libgl1-mesa-dri; or: apt-get install libosmesa6"


class Renderer(NamedTuple):
    """What draws."""

    backend: str  #: as a value of MUJOCO_GL
    name: str  #: as it calls itself, with its version


@cache
def renderer() -> Renderer:
    """The first that works, the user's MUJOCO_GL before others; a `RenderingError` says why none does.

    It takes about a second, once a process.
    """
    problems = []
    for backend in dict.fromkeys((environment().get(WISH, _BACKENDS[0]), *_BACKENDS)):
        try:
            return Renderer(backend, run_python(_PROBE, MUJOCO_GL=backend).strip())
        except RuntimeError as error:
            problems.append(f"{backend}: {error}")
    raise RenderingError(f"nothing here draws pictures with OpenGL ({'; '.join(problems)}): {INSTALL}")


def attach() -> None:
    """Have MuJoCo in this process draw with it, whatever it was imported with. Raises as `renderer` does."""
    from importlib import reload

    import mujoco.gl_context

    os.environ["MUJOCO_GL"] = renderer().backend
    os.environ.pop("PYOPENGL_PLATFORM", None)  # of a shell; MuJoCo sets it anew
    reload(mujoco.gl_context)
