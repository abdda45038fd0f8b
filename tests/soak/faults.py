"""What is done to a sweep under way. Every fault leaves it ended or running; whoever called starts it again."""

from __future__ import annotations

import contextlib
import os
import random
import signal
import subprocess
import time
from collections.abc import Callable

from tests.soak.sweep import Sweep

Program = subprocess.Popen[bytes]
Fault = Callable[[Sweep, Program, random.Random], None]

#: Time the program has to leave in good order, seconds; its workers have a minute to checkpoint, and take far less.
LEAVE_S = 60.0
#: Exit codes of a program that was asked to leave: all was done already, or there is more to do.
LEFT = (0, 75)


def kill_worker(sweep: Sweep, _program: Program, rng: random.Random) -> None:
    """SIGKILL for one worker: the program notices and goes on."""
    if workers := sweep.workers():
        send(rng.choice(workers), signal.SIGKILL)


def kill_program(_sweep: Sweep, program: Program, _rng: random.Random) -> None:
    """SIGKILL for the parent alone: its workers must notice, checkpoint and leave."""
    program.kill()
    program.wait()


def kill_everything(sweep: Sweep, program: Program, rng: random.Random) -> None:
    """SIGKILL for parent and workers at once, in any order."""
    victims = [program.pid, *sweep.workers()]
    rng.shuffle(victims)
    for pid in victims:
        send(pid, signal.SIGKILL)
    program.wait()


def terminate(_sweep: Sweep, program: Program, rng: random.Random) -> None:
    """SIGTERM or SIGINT: every worker checkpoints, and the program leaves with the code for "incomplete".

    Raises:
        AssertionError: it takes too long, or leaves with another code.
    """
    program.send_signal(rng.choice((signal.SIGTERM, signal.SIGINT)))
    code = program.wait(LEAVE_S)
    # A signal that comes while Python itself still starts ends it there and then, before there is anything to save.
    assert code in (*LEFT, 130, -signal.SIGTERM, -signal.SIGINT), f"left with {code} after a request to stop"


def pause(sweep: Sweep, program: Program, rng: random.Random) -> None:
    """SIGSTOP for a worker or the parent, and SIGCONT a moment later."""
    victim = rng.choice([program.pid, *sweep.workers()])
    send(victim, signal.SIGSTOP)
    time.sleep(rng.uniform(0.1, 1.5))
    send(victim, signal.SIGCONT)


#: Each with how often it comes, in parts of the sum.
FAULTS: dict[Fault, int] = {kill_worker: 4, kill_program: 2, kill_everything: 4, terminate: 2, pause: 2}


def send(pid: int, number: signal.Signals) -> None:
    """Signal a process that may be gone."""
    with contextlib.suppress(ProcessLookupError):
        os.kill(pid, number)
