"""One sweep under attack, and its comparison with an undisturbed one."""

from __future__ import annotations

import hashlib
import random
import subprocess
import time
from collections import Counter

from rrmctl.store.layout import Layout
from tests.soak.faults import FAULTS, Program
from tests.soak.sweep import Curve, Sweep

#: Workers whose parent is gone look for it twice a second and checkpoint before they leave.
ORPHAN_S = 30.0
#: Attacks on one sweep after which it is left in peace; a run that is killed before each evaluation makes no way.
MOST = 40


def attacked(sweep: Sweep, rng: random.Random, pause_s: float) -> Counter[str]:
    """See a sweep through to its end in spite of random faults, `pause_s` seconds apart on average.

    Returns:
        Faults by name, `starts` of the program, evaluations `lost` that had been on disk, and `orphans`.
    """
    found: Counter[str] = Counter()
    known: dict[str, Curve] = {}
    program = sweep.start()
    found["starts"] += 1
    while True:
        ended = waited(program, rng.expovariate(1 / pause_s) if sum(found.values()) < MOST else None)
        if ended is not None and ended == 0:
            break
        if ended is None:
            (fault,) = rng.choices(list(FAULTS), list(FAULTS.values()))
            fault(sweep, program, rng)
            found[fault.__name__] += 1
        if program.poll() is not None and program.returncode != 0:
            now = sweep.curves()
            found["lost"] += sum(now.get(run, ())[: len(curve)] != curve for run, curve in known.items())
            known = now
            program = sweep.start()
            found["starts"] += 1
    deadline = time.monotonic() + ORPHAN_S
    while (left := sweep.workers()) and time.monotonic() < deadline:
        time.sleep(0.1)
    found["orphans"] += len(left)
    return found


def compared(quiet: Sweep, loud: Sweep) -> Counter[str]:
    """`jobs` of the attacked sweep, `mismatches` with the undisturbed one, and runs that ended `twice`."""
    found: Counter[str] = Counter()
    undisturbed = quiet.curves()
    for run, curve in loud.curves().items():
        found["jobs"] += 1
        same = curve == undisturbed.get(run) and _networks(quiet, run) == _networks(loud, run)
        found["mismatches"] += not same
    found["twice"] += len(loud.finished_twice())
    return found


def waited(program: Program, seconds: float | None) -> int | None:
    """The exit code of a program that ends within this time; None if it goes on."""
    try:
        return int(program.wait(seconds))
    except subprocess.TimeoutExpired:
        return None


def _networks(sweep: Sweep, run: str) -> str | None:
    path = Layout(sweep.results).run(run).model
    return hashlib.sha256(path.read_bytes()).hexdigest() if path.exists() else None
