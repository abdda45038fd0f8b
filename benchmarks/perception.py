"""How well the cameras find the cube: error of position and yaw over random poses on the simulated rig.

The cameras are the rig's: calibrated from pictures of a board, and touched since then; distorted, blurred, noisy. A
quarter of the poses are in the air. "In the hand": the gripper is around the cube or up to 5 cm above it, open.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from benchmarks.lines import Line
from rrm.envs.panda.physics import Pose, Vector
from rrm.robot.config import RigConfig
from rrm.robot.perception import Gate, locate, wrapped
from rrm.robot.setup import calibration, marked_cube, optics, touched

POSES = 200
RIGS = tuple(RigConfig(seed=seed) for seed in range(5))
#: What is asked of two cameras.
MILLIMETRES, DEGREES = 2.0, 1.0
_ASIDE: Vector = (0.4, 0.28, 0.3)  # where the hand hides nothing


@dataclass
class Errors:
    """Of the poses that were found, and how many were not, or not well enough to count."""

    position: list[float] = field(default_factory=list)  #: millimetres
    yaw: list[float] = field(default_factory=list)  #: degrees
    lost: int = 0


def lines(poses: int = POSES, rigs: Sequence[RigConfig] = RIGS) -> list[Line]:
    """Args: how many poses altogether; the set-ups that they are shared among. Nothing where PyBullet is missing."""
    if find_spec("pybullet") is None:
        return []
    found: dict[tuple[bool, int], Errors] = {(hidden, views): Errors() for hidden in (False, True) for views in (2, 1)}
    for config in rigs:
        measure(config, poses // len(rigs), found)
    out = []
    for (hidden, views), errors in found.items():
        where = f"the cube {'in the hand' if hidden else 'free'}, {'two cameras' if views == 2 else 'one camera'}"
        for what, values, unit, bound in (
            ("position", errors.position, "mm", MILLIMETRES),
            ("yaw", errors.yaw, "deg", DEGREES),
        ):
            note = f"95 %: {np.percentile(values, 95):.2f}, worst {max(values):.2f}; lost {errors.lost} of {poses}"
            asked = bound if views == 2 else None
            out.append(Line(item=f"{where}: {what}", ours=float(np.mean(values)), unit=unit, bound=asked, note=note))
    return out


def measure(config: RigConfig, poses: int, found: Mapping[tuple[bool, int], Errors]) -> None:
    """Add the errors of one set-up: hidden or not, with both cameras and with one."""
    from rrm.envs.panda.scene import Look, Scene
    from rrm.robot.eye import photograph

    known, eyes, rng = calibration(config).cameras, touched(config), np.random.default_rng(config.seed)
    with tempfile.TemporaryDirectory() as folder:
        mesh, texture = marked_cube(config).write(Path(folder))
        scene = Scene(look=Look(mesh=mesh, texture=texture))
        for hidden in [False, True] * poses:
            x, y, yaw, up, above = rng.uniform((0.42, -0.17, -np.pi, -0.3, 0), (0.6, 0.17, np.pi, 0.1, 0.05)).tolist()
            cube = Pose((x, y, 0.025 + max(up, 0.0)), yaw)
            scene.place((x, y, cube.position[2] + above) if hidden else _ASIDE, cube, closed=not hidden)
            pictures = {name: photograph(scene, eye, optics(config), rng) for name, eye in eyes.items()}
            for views in (2, 1):
                errors = found[hidden, views]
                sight = locate(dict(list(pictures.items())[:views]), known, marked_cube(config))
                if sight is None or sight.deviation > Gate().deviation:
                    errors.lost += 1
                    continue
                errors.position.append(1e3 * float(np.linalg.norm(np.subtract(sight.position, cube.position))))
                errors.yaw.append(abs(float(np.degrees(wrapped(sight.yaw - yaw)))))
        scene.close()
