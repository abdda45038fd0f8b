"""Pictures of a MuJoCo simulation as it stands; looking changes nothing of it."""

from __future__ import annotations

import atexit
import weakref
from typing import TYPE_CHECKING, Any, NamedTuple

import mujoco

from rrm.envs.spaces import FrameSpace
from rrm.rendering import attach

if TYPE_CHECKING:
    from rrm.types import Pixels

#: Pictures for people. The rate is slower than life: control lasts 1/80 to 1/40 s.
PEOPLE: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 20}
_SIZE = FrameSpace(360, 480)


class Vantage(NamedTuple):
    """Where a person looks from: angles in degrees, lengths in metres."""

    azimuth: float
    elevation: float
    distance: float
    lookat: tuple[float, float, float]


class Camera:
    """Whatever views of one model are asked for. It opens OpenGL for the first picture of each size and quality."""

    def __init__(self, model: Any) -> None:
        self._model = model
        self._as_shipped = model.vis.quality.offsamples, model.vis.quality.shadowsize
        self._renderers: dict[tuple[int, int, str], mujoco.Renderer] = {}

    def picture(self, data: Any, space: FrameSpace, camera: Any = None) -> Pixels:
        """What the view `space.view`, or MuJoCo's `camera`, shows, uint8 [height, width, 3] RGB, as it is mounted.

        Raises RenderingError where nothing draws.
        """
        size = space.height, space.width, space.quality
        if size not in self._renderers:
            self._renderers[size] = self._open(*size)
        renderer = self._renderers[size]
        renderer.update_scene(data, camera=camera or space.view)
        picture: Pixels = renderer.render()
        return picture

    def portrait(self, data: Any, vantage: Vantage) -> Pixels:
        """What a person is shown, uint8 [360, 480, 3] RGB. Raises as `picture`."""
        free = mujoco.MjvCamera()
        free.azimuth, free.elevation, free.distance = vantage[:3]
        free.lookat[:] = vantage.lookat
        return self.picture(data, _SIZE, free)

    def _open(self, height: int, width: int, quality: str) -> mujoco.Renderer:
        attach()
        fast, vis = quality == "fast", self._model.vis
        # Read when a renderer is made. The cost is that of the robot's meshes, once more for every sample and shadow.
        vis.quality.offsamples, vis.quality.shadowsize = (0, 0) if fast else self._as_shipped
        vis.global_.offheight, vis.global_.offwidth = height, width
        renderer = mujoco.Renderer(self._model, height, width)
        atexit.register(_close, weakref.ref(self))  # before OpenGL ends, which registered earlier
        if fast:
            for flag in (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION):
                renderer.scene.flags[flag] = False
        return renderer

    def close(self) -> None:
        """Give OpenGL back."""
        while self._renderers:
            self._renderers.popitem()[1].close()


def _close(camera: weakref.ref[Camera]) -> None:
    if (left := camera()) is not None:
        left.close()
