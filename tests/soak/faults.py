"""What is done to a sweep under way. Programs that a fault ends are started again by whoever called it."""

from __future__ import annotations

import contextlib
import os
import random
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field

from tests.soak.sweep import Sweep

Program = subprocess.Popen[bytes]
Fault = Callable[["Arena"], None]

#: Time a program has to leave in good order, seconds: its workers have a minute to checkpoint, a frozen one uses it.
LEAVE_S = 90.0
#: A signal this soon after the start may meet Python itself, which ends there and then: nothing was begun. Starting
#: takes a fraction of a second, and much longer where thirty processes share two cores.
STARTING_S = 10.0
#: How long a worker is frozen, seconds: longer than a lease.
FROZEN_S = 40.0
#: Exit codes of a program that was asked to leave: all was done already, or there is more to do.
LEFT = (0, 75)


@dataclass
class Arena:
    """One sweep, the programs that work on it at once, and what was done to them."""

    sweep: Sweep
    rng: random.Random
    found: Counter[str] = field(default_factory=Counter)
    programs: dict[Program, float] = field(default_factory=dict)  #: living ones, with when they were started
    frozen: dict[int, float] = field(default_factory=dict)  #: workers, with when they are to be woken

    def start(self) -> None:
        """One more program on the sweep."""
        self.programs[self.sweep.start()] = time.monotonic()
        self.found["starts"] += 1

    def any_program(self) -> Program:
        """One of those that live."""
        return self.rng.choice(list(self.programs))

    def kill(self, pid: int) -> None:
        """End a process with SIGKILL, if it is still there."""
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)
            self.found["kills"] += 1

    def wake(self, *, everyone: bool = False) -> None:
        """Continue the workers that have been frozen for long enough."""
        for pid, until in list(self.frozen.items()):
            if everyone or time.monotonic() >= until:
                send(pid, signal.SIGCONT)
                del self.frozen[pid]


def kill_worker(arena: Arena) -> None:
    """SIGKILL for one worker: its program notices and goes on."""
    if workers := arena.sweep.workers():
        arena.kill(arena.rng.choice(workers))


def kill_program(arena: Arena) -> None:
    """SIGKILL for a program alone: its workers must notice, checkpoint and leave."""
    program = arena.any_program()
    arena.kill(program.pid)
    program.wait()


def kill_everything(arena: Arena) -> None:
    """SIGKILL for all programs and workers at once, in any order."""
    victims = [*(each.pid for each in arena.programs), *arena.sweep.workers()]
    arena.rng.shuffle(victims)
    for pid in victims:
        arena.kill(pid)
    for program in arena.programs:
        program.wait()


def terminate(arena: Arena) -> None:
    """SIGTERM or SIGINT: every worker checkpoints, and the program leaves in time with the code for "incomplete"."""
    program = arena.any_program()
    starts = time.monotonic() - arena.programs[program] < STARTING_S
    program.send_signal(arena.rng.choice((signal.SIGTERM, signal.SIGINT)))
    try:
        code = program.wait(LEAVE_S)
    except subprocess.TimeoutExpired:
        code = None
    if code not in LEFT and not (starts and code in (130, 1, -signal.SIGTERM, -signal.SIGINT)):
        arena.found["wrong ends"] += 1
        sys.stderr.write(f"after a request to stop a program left with {code}\n")


def pause(arena: Arena) -> None:
    """SIGSTOP for a worker or a program, and SIGCONT a moment later."""
    victim = arena.rng.choice([arena.any_program().pid, *arena.sweep.workers()])
    send(victim, signal.SIGSTOP)
    time.sleep(arena.rng.uniform(0.1, 1.5))
    send(victim, signal.SIGCONT)


def rival(arena: Arena) -> None:
    """One more program on the same folder, up to four."""
    if len(arena.programs) < 4:
        arena.start()


def freeze(arena: Arena) -> None:
    """SIGSTOP for a worker, for longer than a lease, with another program there to take its run over."""
    if workers := [pid for pid in arena.sweep.workers() if pid not in arena.frozen]:
        rival(arena)
        pid = arena.rng.choice(workers)
        send(pid, signal.SIGSTOP)
        arena.frozen[pid] = time.monotonic() + FROZEN_S


#: Each with how often it comes, in parts of the sum.
FAULTS: dict[Fault, int] = {
    kill_worker: 6, kill_program: 3, kill_everything: 5, terminate: 3, pause: 3, rival: 2, freeze: 1
}  # fmt: skip


def send(pid: int, number: signal.Signals) -> None:
    """Signal a process that may be gone."""
    with contextlib.suppress(ProcessLookupError):
        os.kill(pid, number)
