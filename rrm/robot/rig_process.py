"""The rig's process: the simulated arm, what keeps it safe, its cameras, and who knows how an episode stands.

Its clock is the simulation's: time passes in `wait` alone, so that the same commands give the same episode however
quick the machine is. It stops the arm when no command comes for a while, and when the line is closed.
"""

from __future__ import annotations

import socket
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rrm.envs.panda.physics import Vector, varied
from rrm.envs.panda.rules import NEAR, RULES
from rrm.envs.panda.scene import Look, Scene
from rrm.errors import NumericalError
from rrm.robot.channel import Channel, Message
from rrm.robot.config import RigConfig
from rrm.robot.eye import photograph
from rrm.robot.interface import PERIOD_S, Guard
from rrm.robot.setup import marked_cube, optics, touched

if TYPE_CHECKING:
    from rrm.types import Pixels

_STILL: Vector = (0.0, 0.0, 0.0)


def say(text: str) -> None:
    """A line for the rig's log."""
    sys.stderr.write(f"{text}\n")
    sys.stderr.flush()


class World:
    """What is on the table. Each public method but `stop` answers the request of its name."""

    def __init__(self, config: RigConfig, folder: Path) -> None:
        mesh, texture = marked_cube(config).write(folder)
        self._config, self._eyes = config, touched(config)
        self._scene = Scene(look=Look(mesh=mesh, texture=texture))
        self._guard = Guard(speed=config.speed, watchdog_s=config.watchdog_s)
        self.begin("reach", 0)

    def begin(self, task: str, seed: int) -> Message:
        self._rules, self._rng = RULES[task.removeprefix("panda-")], np.random.default_rng((self._config.seed, 4, seed))
        config = self._config
        physics = varied(
            {name: getattr(config, name) for name in ("cube_mass", "friction", "latency", "gain")}, self._rng
        )
        cube, self._goal = self._rules.draw(self._rng, physics)
        self._limits, self._closed = self._rules.limits(physics), not self._rules.picks
        self._scene.place(self._rules.start, cube, physics, self._limits, closed=self._closed)
        self._velocity, self._silent_s, self._total = _STILL, 0.0, 0.0
        return {"goal": self._goal}

    def state(self) -> Message:
        return {"hand": self._scene.hand, "opening": self._scene.opening}

    def move(self, velocity: list[float], closed: bool) -> Message:
        try:
            x, y, z = velocity
            self._velocity = self._guard.allowed((x, y, z), self._scene.hand, self._limits)
        except (NumericalError, ValueError) as error:
            self.stop(f"refused: {error}")
            return {"refused": str(error)}
        self._closed, self._silent_s = closed, 0.0
        return {}

    def stop(self, why: str = "told to") -> Message:
        """The hand stands; the fingers keep what they hold."""
        if self._velocity != _STILL:
            say(f"stopped: {why}")
        self._velocity = _STILL
        return {}

    def wait(self) -> Message:
        self._silent_s += PERIOD_S
        if self._guard.expired(self._silent_s):
            self.stop(f"no command for {self._silent_s:.2f} s")
        velocity = self._guard.allowed(self._velocity, self._scene.hand, self._limits)
        self._scene.step(velocity, closed=self._closed)
        self._total += self._rules.reward(self._scene.hand, self._scene.cube.position, self._goal)
        return {}

    def truth(self) -> Message:
        left = self._rules.left(self._scene.hand, self._scene.cube.position, self._goal)
        return {"success": left < NEAR and not self._scene.lost, "total": self._total}

    def pictures(self) -> dict[str, Pixels]:
        """What the cameras see now."""
        return {name: photograph(self._scene, eye, optics(self._config), self._rng) for name, eye in self._eyes.items()}


def serve(line: Channel) -> None:
    """Answer until the line is closed."""
    first, _ = line.receive()
    config = RigConfig.model_validate_json(first["config"])
    with tempfile.TemporaryDirectory() as folder:
        world = World(config, Path(folder))
        line.send({"sizes": dict.fromkeys(touched(config), (config.width, config.height))})
        try:
            while True:
                asked, _ = line.receive()
                what = asked.pop("do")
                if what == "images":
                    line.send({}, world.pictures())
                else:
                    line.send(_HANDLERS[what](world, **asked))
        except (EOFError, OSError):
            world.stop("the line was closed")


_HANDLERS: dict[str, Any] = {
    "begin": World.begin, "state": World.state, "move": World.move, "stop": World.stop, "wait": World.wait,
    "truth": World.truth,
}  # fmt: skip


def main() -> None:
    """The process: its one argument is the number of the socket's descriptor."""
    serve(Channel(socket.socket(fileno=int(sys.argv[1]))))
