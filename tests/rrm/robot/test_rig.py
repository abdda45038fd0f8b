"""The simulated workplace: a process of its own that keeps its arm safe, whatever happens on this side of the line."""

import os
import signal
import subprocess
import sys
import tempfile

import numpy as np
import pytest

from rrm.environ import environment
from rrm.envs.panda.physics import Limits
from rrm.errors import NumericalError, RobotError
from rrm.robot.config import RigConfig
from rrm.robot.interface import PERIOD_S, Guard
from rrm.robot.rig import Rig
from tests.robot import robot

pytestmark = robot
STILL = RigConfig(latency=(0, 0), width=320, height=240)
GUARD = Guard(speed=0.4, watchdog_s=0.2)
LIMITS = Limits()


@pytest.fixture(scope="module")
def shared():
    with tempfile.TemporaryFile() as log:
        rig = Rig(STILL, log)
        yield rig, log
        rig.close()


@pytest.fixture
def rig(shared):
    """The one that all share, at the beginning of an episode, with nothing in its log."""
    rig, log = shared
    rig.begin("panda-pick-and-reach", 0)
    log.seek(0)  # the process writes where we stand
    log.truncate()
    return rig


@pytest.fixture
def mortal():
    """One of its own, for a test that ends it."""
    rig = Rig(STILL)
    yield rig
    rig.close()


@pytest.fixture
def said(shared):
    """What the shared one has said so far."""
    _, log = shared

    def said():
        log.seek(0)
        return log.read().decode()

    return said


def test_a_guard_lets_the_usual_through():
    assert GUARD.allowed((0.1, -0.1, 0.2), (0.5, 0.0, 0.1), LIMITS) == pytest.approx((0.1, -0.1, 0.2))


def test_a_guard_limits_the_speed():
    """The direction stays."""
    fast = GUARD.allowed((3.0, -4.0, 0.0), (0.5, 0.0, 0.1), LIMITS)
    assert fast == pytest.approx((0.24, -0.32, 0.0))


def test_a_guard_keeps_the_hand_in_its_box():
    """At the edge it stops, beyond it (the arm sags) it may come back, and is not driven back by itself."""
    low, high = LIMITS.low, LIMITS.high
    assert GUARD.allowed((0.3, 0.3, 0.0), high, LIMITS) == (0.0, 0.0, 0.0)
    assert GUARD.allowed((0.2, 0.0, 0.0), (high[0] - 0.005, 0.0, 0.1), LIMITS)[0] == pytest.approx(0.005 / PERIOD_S)
    beyond = (0.5, 0.0, low[2] - 0.01)
    assert GUARD.allowed((0.0, 0.0, 0.0), beyond, LIMITS) == (0.0, 0.0, 0.0)
    assert GUARD.allowed((0.0, 0.0, -0.1), beyond, LIMITS) == (0.0, 0.0, 0.0)
    assert GUARD.allowed((0.0, 0.0, 0.1), beyond, LIMITS)[2] == pytest.approx(0.1)


def test_it_moves_as_it_is_told(rig):
    """A velocity for a second of its own time; pictures are of the size it says."""
    before = rig.state()
    assert before.opening > 0.07
    for _ in range(20):
        rig.move((0.1, 0.0, 0.05), closed=True)
        rig.wait()
    after = rig.state()
    assert np.subtract(after.hand, before.hand) == pytest.approx((0.1, 0.0, 0.05), abs=0.012)
    assert after.opening < 0.06
    assert (
        {name: (p.shape[1], p.shape[0]) for name, p in rig.images().items()}
        == rig.sizes
        == dict.fromkeys(("front", "side"), (320, 240))
    )


def test_it_stops_where_no_command_comes(rig, said):
    """By itself, after its watchdog's time; what it was told before is no longer in force."""
    rig.move((0.2, 0.0, 0.0), closed=False)
    for _ in range(8):
        rig.wait()
    assert "stopped: no command for 0.25 s" in said()
    there = rig.state().hand
    rig.wait()
    rig.wait()
    assert np.linalg.norm(np.subtract(rig.state().hand, there)) < 1e-3


def test_it_does_not_leave_its_box(rig):
    """However long it is told to."""
    for _ in range(60):
        rig.move((0.4, 0.0, 0.0), closed=False)
        rig.wait()
    assert rig.state().hand[0] < LIMITS.high[0] + 0.005


@pytest.mark.parametrize("velocity", [(float("nan"), 0.0, 0.0), (0.0, float("inf"), 0.0)])
def test_it_refuses_what_is_not_finite(rig, said, velocity):
    """One message, and the arm stops; the line goes on."""
    rig.move((0.2, 0.0, 0.0), closed=False)
    rig.wait()
    with pytest.raises(NumericalError, match=r"a velocity of \[.*(nan|inf).*\] m/s was commanded: the arm stops"):
        rig.move(velocity, closed=False)
    assert "stopped: refused" in said()
    rig.wait()
    there = rig.state().hand
    rig.wait()
    assert np.linalg.norm(np.subtract(rig.state().hand, there)) < 2e-3


def test_the_same_commands_give_the_same_episode(rig):
    """Whoever else has used the rig before; the physics of another episode is another."""

    def episode(task, seed):
        goal = rig.begin(task, seed)
        for at in range(15):
            rig.move((0.1, 0.05 * np.sin(at), 0.0), closed=True)
            rig.wait()
        return goal, rig.state(), rig.truth(), rig.images()["front"].tobytes()

    first = episode("panda-push", 3)
    assert episode("panda-reach", 4) != first
    assert episode("panda-push", 3) == first


def test_a_rig_that_dies(mortal):
    """One message, at the next request; to stop and close it are no errors."""
    os.kill(mortal.pid, signal.SIGKILL)
    with pytest.raises(RobotError, match=r"the rig ended \(code -9\)"):
        mortal.wait()
    mortal.stop()
    mortal.close()
    with pytest.raises(RobotError, match="the rig is gone"):
        mortal.state()


def test_a_rig_with_a_fault(mortal):
    """Its last words are in the message."""
    with pytest.raises(RobotError, match=r"the rig ended \(code 1\): KeyError: 'walk'"):
        mortal.begin("panda-walk", 0)


@pytest.mark.slow
def test_whoever_holds_the_line_dies():
    """The arm stops and the process ends: it is not left alone with an arm that moves."""
    code = (
        "import sys, os\nfrom rrm.robot.rig import Rig\nfrom rrm.robot.config import RigConfig\n"
        "rig = Rig(RigConfig(width=320, height=240), open(sys.argv[1], 'ab+'))\n"
        "rig.move((0.1, 0.0, 0.0), closed=True)\nprint(rig.pid, flush=True)\nos.kill(os.getpid(), 9)"
    )
    with tempfile.NamedTemporaryFile() as file:
        done = subprocess.run(
            [sys.executable, "-c", code, file.name], capture_output=True, text=True, env=environment(), check=False
        )
        assert done.returncode == -9, done.stderr
        _await_end(int(done.stdout))
        assert "stopped: the line was closed" in file.read().decode()


def _await_end(pid):
    """Until no process of this number is at work."""
    import time

    for _ in range(600):
        try:
            os.kill(pid, 0)
            with open(f"/proc/{pid}/stat") as file:  # noqa: PTH123
                if file.read().rpartition(")")[2].split()[0] == "Z":
                    return
        except (ProcessLookupError, FileNotFoundError):
            return
        time.sleep(0.05)
    raise AssertionError(f"process {pid} has not ended")


@pytest.mark.slow
@pytest.mark.parametrize("line", ["rig.wait()", "rig.images()"])
def test_ctrl_c_stops_the_arm(line):
    """Whatever the loop is at; the rig itself does not hear it, and ends with the line."""
    code = (
        "import sys, os, signal, threading\nfrom rrm.robot.rig import Rig\nfrom rrm.robot.config import RigConfig\n"
        "rig = Rig(RigConfig(width=320, height=240), open(sys.argv[1], 'ab+'))\n"
        "rig.move((0.05, 0.0, 0.0), closed=True)\n"
        "try:\n    threading.Timer(0.3, os.killpg, (os.getpgrp(), signal.SIGINT)).start()\n"
        "    while True:\n        rig.move((0.05, 0.0, 0.0), closed=True)\n"
        f"        {line}\n"
        "except KeyboardInterrupt:\n    rig.stop()\n    rig.close()\n    print('left')\n"
    )
    with tempfile.NamedTemporaryFile() as file:
        done = subprocess.run(
            [sys.executable, "-c", code, file.name], capture_output=True, text=True, env=environment(),
            process_group=0, check=False,
        )  # fmt: skip
        assert done.stdout == "left\n", done.stderr
        assert "stopped: " in file.read().decode()
