"""A Franka Panda, a table and a cube in PyBullet; whatever moves there follows from a placement and the commands since.

Units and axes are those of `rrm.envs.panda.physics`.
"""

from __future__ import annotations

import math
import weakref
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pybullet
import pybullet_data

from rrm.envs.panda.physics import RATE, Limits, Physics, Pose, Vector, lying

__all__ = ["RATE", "Limits", "Look", "Physics", "Pose", "Scene", "Vector", "View", "lying"]

_URDF = Path(pybullet_data.getDataPath(), "franka_panda", "panda.urdf")
_ARM, _FINGERS, _HAND = range(7), (9, 10), 11
_HOME = (0.0, -0.215, 0.0, -2.57, 0.0, 2.356, 0.785)  # joints; the hand is at (0.43, 0, 0.235)
_DOWN = (1.0, 0.0, 0.0, 0.0)  # quaternion x, y, z, w
_OPEN = 0.04  # of each finger
_TORQUE = (87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0)
_GRIP = 20.0  # N, of each finger
_TABLE = (0.8, 0.8, 0.05)  # half its sides; it reaches beyond the arm


@dataclass(frozen=True, slots=True)
class Look:
    """How a cube appears: in one colour, or as a mesh of side 1 around the origin, with a picture on it."""

    colour: tuple[float, float, float, float] = (0.85, 0.25, 0.2, 1.0)
    mesh: Path | None = None  #: an OBJ; PyBullet's own box has no use for a picture
    texture: Path | None = None


@dataclass(frozen=True, slots=True)
class View:
    """A pinhole camera: where it is and looks, and the angle of its height, degrees."""

    eye: Vector
    target: Vector
    angle: float = 42.0


class Scene:
    """One simulation, on a client of its own. It must be placed before it steps.

    Args:
        limits: of the hand.
        look: of the cube.
    """

    def __init__(self, limits: Limits | None = None, look: Look | None = None) -> None:
        self.limits = limits or Limits()
        self.physics = Physics()
        self.lost = False  #: the cube has left the table's middle: it stays where it left, and nothing touches it
        self._look = look or Look()
        self.client: int = pybullet.connect(pybullet.DIRECT)
        self.close: Callable[[], None] = weakref.finalize(self, pybullet.disconnect, self.client)  #: ends the client
        self.call("setGravity", 0, 0, -9.81)
        self.robot = self.call("loadURDF", str(_URDF), useFixedBase=True)
        self._bodies: list[int] = []
        self._shapes: dict[Vector, tuple[int, int]] = {}
        self._texture = None if self._look.texture is None else self.call("loadTexture", str(self._look.texture))
        limits_of = [self.call("getJointInfo", self.robot, joint)[8:10] for joint in (*_ARM, *_FINGERS)]
        lowest, highest = zip(*limits_of, strict=True)
        self._solve = partial(
            self.call, "calculateInverseKinematics", self.robot, _HAND,
            lowerLimits=lowest, upperLimits=highest, jointRanges=np.subtract(highest, lowest).tolist(),
            restPoses=(*_HOME, _OPEN, _OPEN), maxNumIterations=20,
        )  # fmt: skip
        self._target: npt.NDArray[np.float64] = np.zeros(3)
        self._pending: deque[tuple[Vector, bool]] = deque()

    def call(self, name: str, *args: Any, **kwargs: Any) -> Any:
        """PyBullet's function of this name, for this simulation."""
        return getattr(pybullet, name)(*args, **kwargs, physicsClientId=self.client)

    def place(
        self,
        hand: Vector,
        cube: Pose,
        physics: Physics | None = None,
        limits: Limits | None = None,
        *,
        closed: bool = True,
    ) -> None:
        """Begin anew, at rest; physics and limits stay as they are where none are given.

        Table and cube are made anew, because PyBullet remembers contacts of bodies that are moved away: what follows
        depends on nothing before. The cube's position is its centre, half its side above the table where it lies.
        """
        self.physics = physics = physics or self.physics
        self.limits, self.lost = limits or self.limits, False
        self.call("setTimeStep", 1 / (RATE * physics.substeps))
        while self._bodies:
            self.call("removeBody", self._bodies.pop())
        self._bodies += self._table(), self._cube(cube, physics)
        joints = _HOME
        for _ in range(10):  # each solution starts from the joints as they are
            self._put(joints, closed)
            joints = self._solve(hand, _DOWN)[: len(_ARM)]
        self._put(joints, closed)
        self._target = np.array(hand)
        self._pending = deque([((0.0, 0.0, 0.0), closed)] * physics.latency)
        self.call("performCollisionDetection")

    def _table(self) -> int:
        shape, shown = self._box(_TABLE, Look(colour=(0.8, 0.8, 0.78, 1.0)))
        table: int = self.call("createMultiBody", 0, shape, shown, (0.5, 0.0, -_TABLE[2]))
        self.call("changeDynamics", table, -1, lateralFriction=1.0)
        return table

    def _cube(self, pose: Pose, physics: Physics) -> int:
        shape, shown = self._box((physics.cube_size / 2,) * 3, self._look)
        turn = pybullet.getQuaternionFromEuler((0, 0, pose.yaw))
        cube: int = self.call("createMultiBody", physics.cube_mass, shape, shown, pose.position, turn)
        damping = {"linearDamping": physics.damping, "angularDamping": physics.damping}
        friction = {"lateralFriction": physics.friction, "spinningFriction": 0.001}
        self.call("changeDynamics", cube, -1, **friction, **damping)
        if self._texture is not None:
            self.call("changeVisualShape", cube, -1, textureUniqueId=self._texture)
        return cube

    def _box(self, half: Vector, look: Look) -> tuple[int, int]:
        """How a box collides and is seen. One of a kind: PyBullet never forgets a shape."""
        if half not in self._shapes:
            if look.mesh is None:
                seen = {"shapeType": pybullet.GEOM_BOX, "halfExtents": half, "rgbaColor": look.colour}
            else:
                scale = [2 * side for side in half]
                seen = {"shapeType": pybullet.GEOM_MESH, "fileName": str(look.mesh), "meshScale": scale}
            shape = self.call("createCollisionShape", pybullet.GEOM_BOX, halfExtents=half)
            self._shapes[half] = shape, self.call("createVisualShape", **seen)
        return self._shapes[half]

    def _put(self, joints: tuple[float, ...], closed: bool) -> None:
        opening = 0.0 if closed else _OPEN
        for joint, angle in zip((*_ARM, *_FINGERS), (*joints, opening, opening), strict=True):
            self.call("resetJointState", self.robot, joint, angle)

    def step(self, velocity: Vector, *, closed: bool = True) -> None:
        """A twentieth of a second: the hand moves at a velocity (m/s along x, y, z), the fingers close or open."""
        self._pending.append((velocity, closed))
        velocity, closed = self._pending.popleft()
        moved = self._target + np.divide(velocity, RATE)
        self._target = np.minimum(np.maximum(moved, self.limits.low), self.limits.high)
        joints = self._solve(self._target.tolist(), _DOWN)[: len(_ARM)]
        opening = 0.0 if closed else _OPEN
        self.call(
            "setJointMotorControlArray", self.robot, (*_ARM, *_FINGERS), pybullet.POSITION_CONTROL,
            targetPositions=(*joints, opening, opening), forces=(*_TORQUE, _GRIP, _GRIP),
            positionGains=[self.physics.gain] * 9,
        )  # fmt: skip
        for _ in range(self.physics.substeps):
            self.call("stepSimulation")
        if not self.lost:
            self._catch()

    def _catch(self) -> None:
        """Hold the cube for good where it has left `limits` by more than their margin, or the table."""
        low, high, at = np.array(self.limits.low), np.array(self.limits.high), np.array(self.cube.position)
        low, high = low - self.limits.margin, high + self.limits.margin
        low[2] = 0.0
        self.lost = not ((low <= at) & (at <= high)).all()
        if self.lost:
            cube, (_, turn) = self._bodies[1], self.call("getBasePositionAndOrientation", self._bodies[1])
            self.call("resetBasePositionAndOrientation", cube, np.clip(at, low, high).tolist(), turn)
            self.call("changeDynamics", cube, -1, mass=0)
            self.call("setCollisionFilterGroupMask", cube, -1, 0, 0)

    @property
    def hand(self) -> Vector:
        """Where the hand is."""
        position: Vector = self.call("getLinkState", self.robot, _HAND, computeForwardKinematics=True)[4]
        return position

    @property
    def opening(self) -> float:
        """Between the fingers, 0 to 0.08."""
        return float(sum(self.call("getJointState", self.robot, finger)[0] for finger in _FINGERS))

    @property
    def cube(self) -> Pose:
        """Where the cube is."""
        position, (_, _, z, w) = self.call("getBasePositionAndOrientation", self._bodies[1])
        # Of a cube that was tipped over PyBullet's Euler angles may be anything.
        return Pose(position, math.remainder(2 * math.atan2(z, w), math.tau))

    def picture(self, view: View, width: int, height: int, *, ball: Vector | None = None) -> npt.NDArray[np.uint8]:
        """What a camera sees, uint8 [height, width, 3] RGB, with a ball somewhere; looking changes nothing."""
        seen = pybullet.computeViewMatrix(view.eye, view.target, (0, 0, 1))
        lens = pybullet.computeProjectionMatrixFOV(view.angle, width / height, 0.05, 5.0)
        if ball is not None:
            shown = self.call("createVisualShape", pybullet.GEOM_SPHERE, radius=0.02, rgbaColor=(0.2, 0.65, 0.3, 1))
            body = self.call("createMultiBody", 0, -1, shown, ball)
        drawn = self.call(
            "getCameraImage", width, height, seen, lens, lightDirection=(0.6, -0.8, 2.0), shadow=0,
            flags=pybullet.ER_NO_SEGMENTATION_MASK, renderer=pybullet.ER_TINY_RENDERER,
        )  # fmt: skip
        if ball is not None:
            self.call("removeBody", body)
        picture: npt.NDArray[np.uint8] = np.reshape(drawn[2], (height, width, 4))[..., :3].astype(np.uint8)
        return picture
