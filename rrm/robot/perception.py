"""Where the cube is, from pictures: its markers in all views, fused by one least squares over all their corners.

The cube is taken to stand upright: x, y, z and yaw are what is estimated. One marker of one view starts it
(`solvePnP`, IPPE_SQUARE); what that is off by in depth, the corners of the others and the second view put right.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import cv2
import numpy as np

from rrm.errors import CalibrationError, PerceptionError
from rrm.robot.camera import Camera
from rrm.robot.markers import MarkedCube, detect, others

if TYPE_CHECKING:
    from rrm.envs.base import Doubles
    from rrm.types import Pixels

_ROUNDS = 6  # of Gauss-Newton, which has settled after four
_LEAST_PX = 0.3  # by which corners are off, however well they fit


@dataclass(frozen=True, kw_only=True)
class Sight:
    """An estimate of where the cube is, and how good it is."""

    position: tuple[float, float, float]  #: of its centre in the base frame, metres
    yaw: float  #: radians in (-pi, pi]
    views: int  #: cameras that contributed
    markers: int  #: in all of them together
    error_px: float  #: reprojection error of all corners, root mean square
    deviation: float  #: of the position, metres: one standard deviation, if corners are off by as much as they misfit
    age: int = 0  #: frames since it was seen; 0: in this one


@dataclass(frozen=True, kw_only=True)
class Gate:
    """What an estimate must be like to count."""

    deviation: float = 0.008  #: metres at most: one marker, small or seen by one camera alone, is poor in depth
    error_px: float = 2.0  #: at most
    jump: float = 0.05  #: metres at most from the one before, for each frame since then


@dataclass(frozen=True)
class _View:
    """Corners seen by one camera: in the cube's frame [n, 3], and as rays [n, 2] at one metre."""

    camera: Camera
    corners: Doubles
    rays: Doubles


def locate(pictures: Mapping[str, Pixels], cameras: Mapping[str, Camera], cube: MarkedCube) -> Sight | None:
    """The cube's pose by all pictures, RGB or grey, of the cameras of these names; None where none shows a marker."""
    bodies = cube.corners()
    views, starts, markers = [], [], 0
    for name, picture in pictures.items():
        seen = {number: quad for number, quad in detect(picture, cube.dictionary).items() if number in bodies}
        if not seen:
            continue
        camera = cameras[name]
        rays = {number: camera.rays(quad) for number, quad in seen.items()}
        views.append(_View(camera, np.vstack([bodies[number] for number in seen]), np.vstack(list(rays.values()))))
        markers += len(seen)
        starts += [start for number in seen for start in _starts(camera, bodies[number], rays[number], cube.marker)]
    if not starts:
        return None
    guess = min(starts, key=lambda start: float(np.sum(_residuals(start, views) ** 2)))
    pose, slopes = _refined(guess, views)
    error = float(np.sqrt(np.mean(np.sum(_residuals(pose, views).reshape(-1, 2) ** 2, axis=1))))
    spread = np.linalg.pinv(slopes.T @ slopes)[:3, :3].trace() * max(error, _LEAST_PX) ** 2
    x, y, z, yaw = pose.tolist()
    return Sight(
        position=(x, y, z), yaw=wrapped(yaw), views=len(views), markers=markers, error_px=error,
        deviation=float(np.sqrt(spread)),
    )  # fmt: skip


def wrapped(angle: float) -> float:
    """The angle in (-pi, pi]."""
    return float(np.pi - (np.pi - angle) % (2 * np.pi))


def _starts(camera: Camera, body: Doubles, rays: Doubles, edge: float) -> list[Doubles]:
    """The two poses [x, y, z, yaw] that one marker allows, of the cube set upright."""
    half = edge / 2
    square = np.array([[-half, half, 0], [half, half, 0], [half, -half, 0], [-half, -half, 0]])
    # The marker's own frame, as IPPE_SQUARE wants it, in the cube's.
    frame = np.eye(4)
    right, up = (body[1] - body[0]) / edge, (body[0] - body[3]) / edge
    frame[:3, :3] = np.column_stack((right, up, np.cross(right, up)))
    frame[:3, 3] = body.mean(axis=0)
    _, rotations, translations, _ = cv2.solvePnPGeneric(
        square, rays.reshape(-1, 1, 2), np.eye(3), None, flags=cv2.SOLVEPNP_IPPE_SQUARE
    )
    starts = []
    for rotation, translation in zip(rotations, translations, strict=True):
        marker = np.eye(4)
        marker[:3, :3], marker[:3, 3] = cv2.Rodrigues(rotation)[0], translation.ravel()
        pose = np.linalg.inv(camera.pose) @ marker @ np.linalg.inv(frame)
        starts.append(np.array([*pose[:3, 3], np.arctan2(pose[1, 0], pose[0, 0])]))
    return starts


def _turn(yaw: float) -> Doubles:
    cos, sin = np.cos(yaw), np.sin(yaw)
    return np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])


def _residuals(pose: Doubles, views: list[_View]) -> Doubles:
    """How far every corner is from where the pose would show it, in pixels, [2 n]."""
    out = []
    for view in views:
        world = view.corners @ _turn(pose[3]).T + pose[:3]
        ahead = world @ view.camera.pose[:3, :3].T + view.camera.pose[:3, 3]
        depth = np.maximum(ahead[:, 2:], 1e-3)  # a start behind the camera is merely a bad one
        out.append(((ahead[:, :2] / depth - view.rays) * view.camera.focal).ravel())
    return np.concatenate(out)


def _refined(pose: Doubles, views: list[_View]) -> tuple[Doubles, Doubles]:
    """The pose after Gauss-Newton on all corners, and how the residuals follow it there, [2 n, 4]."""
    step = np.array([1e-6] * 4)
    for _ in range(_ROUNDS):
        here = _residuals(pose, views)
        slopes = np.column_stack([(_residuals(pose + e, views) - here) / 1e-6 for e in np.diag(step)])
        pose = pose - np.linalg.lstsq(slopes, here, rcond=None)[0]
    return pose, slopes


def check_cameras(sizes: Mapping[str, tuple[int, int]], cameras: Mapping[str, Camera]) -> None:
    """Refuse a calibration that is not of these cameras, given as (width, height) in pixels by name.

    Raises:
        CalibrationError: with the camera that is not in it, or is of another size.
    """
    for name, (width, height) in sizes.items():
        if name not in cameras:
            there = ", ".join(sorted(cameras))
            raise CalibrationError(f'the calibration has no camera "{name}", it has {there}: calibrate that one too')
        if (width, height) != (cameras[name].width, cameras[name].height):
            raise CalibrationError(
                f'camera "{name}" gives pictures of {width} x {height}, its calibration is of {cameras[name].size}: '
                "set the camera to that size, or calibrate it at this one"
            )


class Tracker:
    """Where the cube is, frame by frame. What a gate refuses, or nobody sees, is replaced by what was seen last."""

    def __init__(
        self, cameras: Mapping[str, Camera], cube: MarkedCube, *, gate: Gate | None = None, patience: int = 20
    ) -> None:
        """Args:
        cameras: as calibrated, by name.
        gate: what counts.
        patience: frames in a row without an estimate that counts, after which it is an error.
        """
        self._cameras, self._cube, self._gate, self._patience = cameras, cube, gate or Gate(), patience
        self.forget()

    def forget(self) -> None:
        """Begin anew, as where somebody has moved the cube."""
        self._last: Sight | None = None
        self._lost = 0

    def look(self, pictures: Mapping[str, Pixels]) -> Sight | None:
        """The newest estimate, its `age` above 0 where it is held; None while there was none yet.

        Raises:
            PerceptionError: the cube has been lost for too long; the message says why.
        """
        check_cameras({name: (picture.shape[1], picture.shape[0]) for name, picture in pictures.items()}, self._cameras)
        sight = locate(pictures, self._cameras, self._cube)
        problem = self._problem(sight)
        if not problem:
            self._last, self._lost = sight, 0
            return self._last
        self._lost += 1
        if self._lost >= self._patience:
            if sight is None:
                problem += "".join({others(picture, self._cube.dictionary) for picture in pictures.values()})
            raise PerceptionError(f"the cube is lost for {self._lost} frames: {problem}")
        return None if self._last is None else replace(self._last, age=self._lost)

    def _problem(self, sight: Sight | None) -> str:
        """Why an estimate does not count; empty where it does."""
        gate = self._gate
        if sight is None:
            return f"no camera sees a marker of {self._cube.dictionary} that is on it"
        if sight.error_px > gate.error_px:
            return (
                f"its corners are {sight.error_px:.1f} pixels off, {gate.error_px:g} are allowed: "
                "is the calibration of these cameras, and nothing moved since?"
            )
        if sight.deviation > gate.deviation:
            return (
                f"{sight.markers} marker(s) in {sight.views} view(s) tell its place to {1e3 * sight.deviation:.0f} mm, "
                f"{1e3 * gate.deviation:.0f} are allowed"
            )
        jump = 0.0 if self._last is None else float(np.linalg.norm(np.subtract(sight.position, self._last.position)))
        if jump > gate.jump * (self._lost + 1):
            return f"it would have jumped by {jump:.2f} m"
        return ""
