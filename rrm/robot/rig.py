"""A simulated workplace in a process of its own: this side of the line. `rrm.robot.rig_process` is the other."""

from __future__ import annotations

import contextlib
import socket
import subprocess
import sys
import tempfile
from typing import IO, TYPE_CHECKING, Any

from rrm.environ import environment
from rrm.errors import NumericalError, RobotError
from rrm.robot.channel import Channel
from rrm.robot.interface import ArmState, Truth

if TYPE_CHECKING:
    from collections.abc import Mapping

    from rrm.envs.panda.physics import Vector
    from rrm.robot.config import RigConfig
    from rrm.types import Pixels

_PATIENCE_S = 120.0  # that an answer may take
_LEAVING_S = 20.0  # that the process may take to end


class Rig:
    """A `Workplace`. When this end of the line closes, for whatever reason, the arm stops and the process ends."""

    def __init__(self, config: RigConfig, log: IO[bytes] | None = None) -> None:
        """Args:
        config: what it is like.
        log: where the process writes what it has to say; a temporary file where nobody wants to read it.

        Raises:
            RobotError: it does not start; with its last words.
        """
        self._log, self._own = log or tempfile.TemporaryFile(), log is None  # noqa: SIM115 (closed with the rig)
        ours, theirs = socket.socketpair()
        ours.settimeout(_PATIENCE_S)
        with theirs:
            code = "from rrm.robot.rig_process import main; main()"
            self._process = subprocess.Popen(
                (sys.executable, "-c", code, str(theirs.fileno())),
                stdin=subprocess.DEVNULL, stdout=self._log, stderr=self._log,
                env=environment(), pass_fds=(theirs.fileno(),), process_group=0,  # Ctrl-C is not for it
            )  # fmt: skip
        self._line = Channel(ours)
        self._asking = False
        self.sizes: Mapping[str, tuple[int, int]] = {}
        try:
            answer, _ = self._ask("prepare", config=config.model_dump_json())
        except BaseException:
            self.close()
            raise
        self.sizes = {name: (width, height) for name, (width, height) in answer["sizes"].items()}

    @property
    def pid(self) -> int:
        """Of the process."""
        return self._process.pid

    def begin(self, task: str, seed: int) -> Vector:
        x, y, z = self._ask("begin", task=task, seed=seed)[0]["goal"]
        return x, y, z

    def state(self) -> ArmState:
        answer, _ = self._ask("state")
        x, y, z = answer["hand"]
        return ArmState((x, y, z), answer["opening"])

    def move(self, velocity: Vector, *, closed: bool) -> None:
        self._ask("move", velocity=[float(part) for part in velocity], closed=closed)

    def images(self) -> dict[str, Pixels]:
        return self._ask("images")[1]

    def wait(self) -> None:
        self._ask("wait")

    def truth(self) -> Truth:
        answer, _ = self._ask("truth")
        return Truth(answer["success"], answer["total"])

    def stop(self) -> None:
        """As a `Robot`'s; where a question was cut short (Ctrl-C), by closing the line, and the rig is gone."""
        if self._asking:
            self.close()
        elif self._process.returncode is None:
            with contextlib.suppress(RobotError):  # a rig that has ended moves nothing
                self._ask("stop")

    def close(self) -> None:
        self._line.close()
        try:
            self._process.wait(_LEAVING_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        if self._own:
            self._log.close()

    def _ask(self, what: str, **values: Any) -> tuple[dict[str, Any], dict[str, Pixels]]:
        """The answer to one request."""
        if self._process.returncode is not None:
            raise RobotError("the rig is gone")
        self._asking = True
        try:
            self._line.send({"do": what} | values)
            answer, pictures = self._line.receive()
        except TimeoutError:
            self._process.kill()
            raise self._gone(f"gave no answer within {_PATIENCE_S:.0f} s") from None
        except (OSError, EOFError, ValueError):
            raise self._gone("ended") from None
        self._asking = False
        if refusal := answer.get("refused"):
            raise NumericalError(refusal)
        return answer, pictures

    def _gone(self, how: str) -> RobotError:
        """The rig has left us; with the last it said."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(_LEAVING_S)
        self._log.seek(0)
        words = self._log.read().decode(errors="replace").strip().splitlines() or ["it said nothing"]
        self.close()
        return RobotError(f"the rig {how} (code {self._process.returncode}): {words[-1]}")
