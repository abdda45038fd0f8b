"""What a calibrated camera sees of a PyBullet scene."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pybullet

from rrm.robot.pictures import Optics, developed

if TYPE_CHECKING:
    from rrm.envs.base import Doubles
    from rrm.envs.panda.scene import Scene
    from rrm.robot.camera import Camera
    from rrm.types import Pixels

_NEAR, _FAR = 0.05, 5.0  # metres


def lens(camera: Camera) -> Doubles:
    """OpenGL's projection [4, 4] with the camera's intrinsics, without distortion."""
    width, height = camera.width, camera.height
    out = np.zeros((4, 4))
    out[0, 0], out[1, 1] = 2 * camera.focal[0] / width, 2 * camera.focal[1] / height
    # This renderer draws at the lower left corner of a pixel what is in its middle.
    out[0, 2], out[1, 2] = 1 - 2 * camera.centre[0] / width, 2 * (camera.centre[1] + 1) / height - 1
    out[2, 2], out[2, 3] = (_FAR + _NEAR) / (_NEAR - _FAR), 2 * _FAR * _NEAR / (_NEAR - _FAR)
    out[3, 2] = -1
    return out


def photograph(scene: Scene, camera: Camera, optics: Optics, rng: np.random.Generator) -> Pixels:
    """A picture, uint8 [height, width, 3] RGB, by PyBullet's own renderer, and through the camera's lens."""
    view = np.diag((1.0, -1.0, -1.0, 1.0)) @ camera.pose  # OpenGL looks along -z, y up
    drawn = scene.call(
        "getCameraImage", camera.width, camera.height, view.ravel("F").tolist(), lens(camera).ravel("F").tolist(),
        lightDirection=(0.6, -0.8, 2.0), shadow=0, flags=pybullet.ER_NO_SEGMENTATION_MASK,
        renderer=pybullet.ER_TINY_RENDERER,
    )  # fmt: skip
    picture = np.reshape(np.asarray(drawn[2], np.uint8), (camera.height, camera.width, 4))[..., :3]
    return developed(np.ascontiguousarray(picture), camera, optics, rng)
