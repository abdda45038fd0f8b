"""What a camera is: a size, a lens, and where it stands."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import cv2
import numpy as np
from pydantic import Field

from rrm.config import ConfigSection, Count, NonNegative, Weight

if TYPE_CHECKING:
    from rrm.envs.base import Doubles

Vector = tuple[float, float, float]


class Camera(ConfigSection):
    """A calibrated camera, in OpenCV's conventions: x to the right, y down, z ahead; 0 is the middle of a pixel."""

    width: Count  #: pixels
    height: Count
    focal: tuple[float, float]  #: pixels, across and down
    centre: tuple[float, float]  #: principal point, pixels
    distortion: Annotated[tuple[float, ...], Field(min_length=5, max_length=5)] = (0.0,) * 5  #: k1, k2, p1, p2, k3
    rotation: Vector  #: of the robot's base frame into the camera's, axis times angle, radians
    translation: Vector  #: metres
    pictures: NonNegative = 0  #: that it was calibrated from
    error_px: Weight = 0.0  #: reprojection error over them, root mean square
    base_error_px: Weight = 0.0  #: over the one that says where it stands

    @property
    def size(self) -> str:
        """In words."""
        return f"{self.width} x {self.height}"

    @property
    def matrix(self) -> Doubles:
        """Intrinsics [3, 3]."""
        return np.array([[self.focal[0], 0, self.centre[0]], [0, self.focal[1], self.centre[1]], [0, 0, 1]])

    @property
    def pose(self) -> Doubles:
        """Base frame to camera frame, [4, 4]."""
        return rigid(self.rotation, self.translation)

    def project(self, points: Doubles) -> Doubles:
        """Pixels [n, 2] of points [n, 3] in the base frame."""
        pixels, _ = cv2.projectPoints(
            points, np.array(self.rotation), np.array(self.translation), self.matrix, np.array(self.distortion)
        )
        return np.asarray(pixels.reshape(-1, 2), float)

    def rays(self, pixels: Doubles) -> Doubles:
        """Where pixels [n, 2] lie at one metre ahead, [n, 2] metres in the camera's frame: without the lens' error."""
        lines = cv2.undistortPoints(pixels.reshape(-1, 1, 2), self.matrix, np.array(self.distortion))
        return np.asarray(lines.reshape(-1, 2), float)


def rigid(rotation: Doubles | Vector, translation: Doubles | Vector) -> Doubles:
    """[4, 4] of a rotation (axis times angle) and a translation."""
    out = np.eye(4)
    out[:3, :3] = cv2.Rodrigues(np.asarray(rotation, float))[0]
    out[:3, 3] = np.ravel(translation)
    return out


def placed(camera: Camera, pose: Doubles) -> Camera:
    """The same camera where `pose` [4, 4] takes the base frame into its own."""
    return camera.model_copy(update={
        "rotation": tuple(np.ravel(cv2.Rodrigues(pose[:3, :3])[0]).tolist()), "translation": tuple(pose[:3, 3].tolist())
    })  # fmt: skip


def looking(camera: Camera, eye: Vector, at: Vector) -> Camera:
    """The same camera at `eye`, upright, with `at` in the middle of its picture."""
    ahead = np.subtract(at, eye) / np.linalg.norm(np.subtract(at, eye))
    right = np.cross(ahead, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = right, np.cross(ahead, right), ahead
    pose[:3, 3] = -pose[:3, :3] @ eye
    return placed(camera, pose)
