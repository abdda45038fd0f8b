"""Attack sweeps until the time is up, and say what was found.

    python -m tests.soak --minutes 20 [--seed 0] [--sweep "toy-car --profile smoke --seeds 2"]...

First a hundred jobs of a second run under twenty workers, of which one is killed every second, and what that cost is
told. Then each sweep first runs undisturbed, and again and again in a folder of its own under random faults: it must
end with the same evaluations and networks, bit for bit. Exit code 1 where anything was lost or differs.
"""

from __future__ import annotations

import argparse
import random
import shlex
import shutil
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from tests.soak.attack import attacked, compared
from tests.soak.storm import Storm
from tests.soak.sweep import Sweep

#: Many short runs, evaluated and checkpointed several times a second.
DEFAULT = (
    "toy-car --profile smoke --seeds 3 --set steps=1500 --set evaluation.every=50 --set evaluation.episodes=1",
    "toy-car --profile smoke --seeds 1 --prior language",
)

#: What must never happen.
NEVER = ("mismatches", "lost", "twice", "orphans", "wrong ends", "readers")


def main() -> int:
    """Run the soak and print one line a sweep, then the sums."""
    parser = argparse.ArgumentParser(prog="python -m tests.soak", description="Attack sweeps at random moments.")
    parser.add_argument("--minutes", type=float, default=20.0)
    parser.add_argument("--seed", type=int, default=None, help="of the faults; by default another each time")
    parser.add_argument("--sweep", action="append", help="arguments of rrmctl run; may be repeated")
    parser.add_argument("--once", action="store_true", help="attack every sweep once, however long it takes")
    parser.add_argument("--pause", type=float, default=3.0, help="mean time between faults, seconds")
    given = parser.parse_args()
    seed = random.SystemRandom().randrange(2**32) if given.seed is None else given.seed
    print(f"faults from seed {seed}")
    if not given.once:
        print(storm(), flush=True)
    until = time.monotonic() + 60 * given.minutes
    totals: Counter[str] = Counter()
    with tempfile.TemporaryDirectory(prefix="rrmctl-soak-") as folder:
        quiet, loud = Path(folder) / "quiet", Path(folder) / "loud"
        rng, turn = random.Random(seed), 0
        sweeps = [tuple(shlex.split(each)) for each in given.sweep or DEFAULT]
        while turn < len(sweeps) if given.once else time.monotonic() < until:
            arguments = sweeps[turn % len(sweeps)]
            if turn < len(sweeps):
                Sweep(arguments, quiet).finish()
            found = attacked(Sweep(arguments, loud), rng, given.pause)
            found += compared(Sweep(arguments, quiet), Sweep(arguments, loud))
            print(f"{' '.join(arguments)}: {told(found)}", flush=True)
            totals += found
            turn += 1
            if not given.once:
                shutil.rmtree(loud)
    resumes = totals["starts"] - turn
    print(
        f"{turn} sweeps, {totals['jobs']} jobs, {totals['kills']} processes killed, {resumes} resumes: {told(totals)}"
    )
    return int(any(totals[name] for name in NEVER))


def storm() -> str:
    """A hundred jobs of a second, in one line."""
    with tempfile.TemporaryDirectory(prefix="rrmctl-storm-") as folder:
        found = Storm(Path(folder), jobs=100, steps=500)
        found.survive()
        return found.told()


def told(found: Counter[str]) -> str:
    """Counts in one line; what must be zero is always named."""
    names = dict.fromkeys((*NEVER, *found))
    return ", ".join(f"{found[name]} {name}" for name in names)


if __name__ == "__main__":
    sys.exit(main())
