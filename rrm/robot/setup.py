"""The simulated set-up: how it differs from the simulation that policies are trained in, and its two cameras.

They are calibrated as a laboratory's are, from pictures of a board, and then they are touched: a real calibration is
never quite that of the moment.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rrm.robot.calibration import BASE, Board, Calibration, Placement, calibrate
from rrm.robot.camera import Camera, looking, placed, rigid
from rrm.robot.markers import MarkedCube
from rrm.robot.pictures import Optics, photograph, shown

if TYPE_CHECKING:
    from rrm.robot.config import RigConfig
    from rrm.types import Pixels

#: Metres in the base frame. One looks at the arm and one from its side, so that the hand, which grips to its left and
#: right and pushes anywhere, hides the cube from one of them at the most.
_EYES = {"front": (1.05, 0.3, 0.4), "side": (0.6, -0.65, 0.35)}
_FOCAL = 0.96  # of the width, as a RealSense D435 has it
_PLACEMENT = Placement(0.3, 0.14, 0.0, 0.0)


def optics(config: RigConfig) -> Optics:
    """Of both cameras."""
    return Optics(blur=config.blur, noise=config.noise)


def marked_cube(config: RigConfig) -> MarkedCube:
    """The one that lies there."""
    return MarkedCube(dictionary=config.dictionary)


def cameras(config: RigConfig) -> dict[str, Camera]:
    """The cameras as they stand while they are calibrated: no two alike."""
    rng = np.random.default_rng((config.seed, 1))
    out = {}
    for name, eye in _EYES.items():
        focal = _FOCAL * config.width * rng.uniform(0.98, 1.02)
        middle = np.array([config.width - 1, config.height - 1]) / 2
        k1, k2, p1, p2 = rng.uniform((0.05, -0.2, -1e-3, -1e-3), (0.15, -0.05, 1e-3, 1e-3)).tolist()
        camera = Camera(
            width=config.width, height=config.height, focal=(focal, focal * float(rng.uniform(0.998, 1.002))),
            centre=tuple((middle + rng.uniform(-0.01, 0.01, 2) * config.width).tolist()),
            distortion=(k1, k2, p1, p2, 0.0), rotation=(0.0, 0.0, 0.0), translation=(0.0, 0.0, 0.0),
        )  # fmt: skip
        x, y, z = (eye + rng.uniform(-0.02, 0.02, 3)).tolist()
        out[name] = looking(camera, (x, y, z), (0.5, 0.0, 0.05))
    return out


def touched(config: RigConfig) -> dict[str, Camera]:
    """The cameras as they stand afterwards."""
    rng = np.random.default_rng((config.seed, 2))
    turn, shift = np.radians(config.bump_deg), config.bump_mm / 1e3
    return {
        name: placed(camera, rigid(rng.normal(0, turn, 3), rng.normal(0, shift, 3)) @ camera.pose)
        for name, camera in cameras(config).items()
    }


def board_pictures(config: RigConfig, camera: Camera, board: Board, rng: np.random.Generator) -> dict[str, Pixels]:
    """What somebody would photograph to calibrate a camera: the board here and there, and in its place on the table."""
    poses = {f"board-{at:02}": pose for at, pose in enumerate(shown(board, camera, config.boards, rng))}
    poses[BASE] = camera.pose @ _PLACEMENT.matrix
    return {name: photograph(board, pose, camera, optics(config), rng) for name, pose in poses.items()}


def calibration(config: RigConfig) -> Calibration:
    """The rig's cameras, calibrated from pictures of a board: some seconds."""
    board, rng = Board(), np.random.default_rng((config.seed, 3))
    found = {
        name: calibrate(board_pictures(config, camera, board, rng), board, _PLACEMENT, name=name)
        for name, camera in cameras(config).items()
    }
    return Calibration(board=board, cameras=found)
