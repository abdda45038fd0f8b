"""One sweep under attack, and its comparison with an undisturbed one."""

from __future__ import annotations

import hashlib
import random
import time
from collections import Counter

from rrmctl.store.layout import Layout
from tests.soak.faults import FAULTS, Arena
from tests.soak.readers import Readers
from tests.soak.sweep import Sweep

#: Workers whose parent is gone look for it twice a second and checkpoint before they leave.
ORPHAN_S = 30.0
#: Attacks on one sweep after which it is left in peace; a run that is killed before each evaluation makes no way.
MOST = 40


def attacked(sweep: Sweep, rng: random.Random, pause_s: float) -> Counter[str]:
    """See a sweep through to its end in spite of random faults, `pause_s` seconds apart on average.

    Returns:
        Faults by name, processes killed (`kills`), `starts` of the program; evaluations `lost` that had been seen,
        errors that `readers` met, programs that ended otherwise than they should (`wrong ends`), and `orphans`.
    """
    arena, attacks, done = Arena(sweep, rng), 0, False
    with Readers(sweep, arena.found):
        while not done or arena.programs:
            if not arena.programs:
                arena.start()
            until = time.monotonic() + rng.expovariate(1 / pause_s)
            while arena.programs and (attacks >= MOST or time.monotonic() < until):
                time.sleep(0.05)
                arena.wake(everyone=attacks >= MOST)
                done |= _reap(arena)
            if arena.programs and attacks < MOST:
                (fault,) = rng.choices(list(FAULTS), list(FAULTS.values()))
                fault(arena)
                arena.found[fault.__name__] += 1
                attacks += 1
        arena.wake(everyone=True)
    deadline = time.monotonic() + ORPHAN_S
    while (left := sweep.workers()) and time.monotonic() < deadline:
        time.sleep(0.1)
    arena.found["orphans"] += len(left)
    return arena.found


def _reap(arena: Arena) -> bool:
    """Take note of programs that have ended; True if one found that all is done."""
    ended = [program for program in arena.programs if program.poll() is not None]
    for program in ended:
        del arena.programs[program]
        # 1: a job failed, which none of these do. Killed ones, and those that were asked to leave, are started again.
        arena.found["wrong ends"] += program.returncode == 1
    return any(program.returncode == 0 for program in ended)


def compared(quiet: Sweep, loud: Sweep) -> Counter[str]:
    """`jobs` of the attacked sweep, `mismatches` with the undisturbed one, and runs that ended `twice`."""
    found: Counter[str] = Counter()
    undisturbed, curves = quiet.curves(), loud.curves()
    for run in loud.runs():
        found["jobs"] += 1
        same = curves.get(run) == undisturbed.get(run) and _networks(quiet, run) == _networks(loud, run)
        found["mismatches"] += not same
    found["twice"] += len(loud.finished_twice())
    return found


def _networks(sweep: Sweep, run: str) -> str | None:
    path = Layout(sweep.results).run(run).model
    return hashlib.sha256(path.read_bytes()).hexdigest() if path.exists() else None
