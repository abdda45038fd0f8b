"""Pictures of things that are not there: what a camera's lens makes of a drawn picture, and photographs of a board.

A board is drawn by OpenCV (a plane seen in perspective), so that calibration needs no simulator.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import cv2
import numpy as np

from rrm.robot.camera import Camera, rigid

if TYPE_CHECKING:
    from rrm.envs.base import Doubles
    from rrm.robot.calibration import Board
    from rrm.types import Floats, Pixels

_FINER = 2  # a board is drawn at this many times the camera's pixels


@dataclass(frozen=True, kw_only=True)
class Optics:
    """What a picture suffers on its way."""

    blur: float = 0.0  #: pixels, the standard deviation of a Gaussian
    noise: float = 0.0  #: of 255, standard deviation, each pixel by itself


def developed(picture: Pixels, camera: Camera, optics: Optics, rng: np.random.Generator) -> Pixels:
    """A picture without lens errors, [height, width, ...], as the camera takes it: distorted, blurred, noisy."""
    out = picture
    if any(camera.distortion):
        out = cv2.remap(out, *_bent(camera), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    if optics.blur > 0:
        out = cv2.GaussianBlur(out, (0, 0), optics.blur)
    if optics.noise > 0:
        grain = optics.noise * rng.standard_normal(out.shape[:2], np.float32)
        noisy = out + (grain if out.ndim == 2 else grain[..., None])
        out = np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
    return out


@lru_cache(maxsize=4)
def _bent(camera: Camera) -> tuple[Floats, Floats]:
    """For every pixel of the camera, where in the undistorted picture it comes from: x and y, float32 [H, W]."""
    down, across = np.mgrid[0 : camera.height, 0 : camera.width].astype(np.float64)
    rays = camera.rays(np.column_stack((across.ravel(), down.ravel())))
    source = (rays * camera.focal + camera.centre).astype(np.float32).reshape(camera.height, camera.width, 2)
    return source[..., 0], source[..., 1]


def photograph(board: Board, pose: Doubles, camera: Camera, optics: Optics, rng: np.random.Generator) -> Pixels:
    """A grey picture of a board whose frame `pose` [4, 4] takes into the camera's."""
    drawn = board.drawn(pixels=round(board.square * 2000))
    per_metre = drawn.shape[1] / (board.columns * board.square)
    onto = camera.matrix @ pose[:3, [0, 1, 3]]  # of metres on the board, which is a plane
    finer = np.array([[_FINER, 0, (_FINER - 1) / 2], [0, _FINER, (_FINER - 1) / 2], [0, 0, 1]])
    metres = np.array([[1 / per_metre, 0, 0.5 / per_metre], [0, 1 / per_metre, 0.5 / per_metre], [0, 0, 1]])
    size = (camera.width * _FINER, camera.height * _FINER)
    fine = cv2.warpPerspective(drawn, finer @ onto @ metres, size, flags=cv2.INTER_AREA, borderValue=150)
    return developed(cv2.resize(fine, (camera.width, camera.height), interpolation=cv2.INTER_AREA), camera, optics, rng)


def shown(board: Board, camera: Camera, count: int, rng: np.random.Generator) -> Iterator[Doubles]:
    """Poses [4, 4] in the camera's frame in which somebody shows it a board: near, tilted, all over the picture."""
    middle = np.array([board.columns, board.rows, 0]) * board.square / 2
    across = max(board.columns, board.rows) * board.square
    for _ in range(count):
        depth = across * camera.focal[0] / camera.width * rng.uniform(1.3, 2.0)
        at = rng.uniform(-0.15, 0.15, 2) * (camera.width, camera.height) / np.array(camera.focal) * depth
        turned = rigid(rng.uniform((-0.6, -0.6, -0.4), (0.6, 0.6, 0.4)), (*at, depth))
        yield turned @ rigid((0.0, 0.0, 0.0), -middle)
