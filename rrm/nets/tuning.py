"""Which way to a product is the quickest on this machine: measured once, by a process that may die of it.

    python -m rrm.nets.tuning        measures, and prints one JSON object for each way as soon as it has been tried

A way counts where its products are as exact as float32 allows. The figures are kept in the user's cache folder, for
this processor and these libraries; another processor, torch or numpy is measured anew.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from rrm import files
from rrm.environ import environment
from rrm.hardware import cpu_model
from rrm.precision import extensions

_PATIENCE_S = 120.0
_TURNS, _TURN_S = 3, 0.002
_CLEARLY = 1.05  #: so much quicker must a way be for one product to leave the one that is the quickest over all


@dataclass(frozen=True)
class Machine:
    """What was measured here."""

    rates: Mapping[str, Mapping[str, float]]  #: operations a second, by way and cell; exact ways alone
    refused: Mapping[str, str] = field(default_factory=dict)  #: why a way is not taken, by its name

    @property
    def choice(self) -> dict[str, str]:
        """The quickest over all cells, and those cells where another is clearly quicker."""
        from rrm.nets.products import OTHERWISE

        def mean(way: str) -> float:
            return sum(map(math.log, self.rates[way].values()))

        best = max(self.rates, key=mean)
        quickest = {cell: max(self.rates, key=lambda way: self.rates[way][cell]) for cell in self.rates[best]}
        leave = {
            cell: way for cell, way in quickest.items() if self.rates[way][cell] > _CLEARLY * self.rates[best][cell]
        }
        return {OTHERWISE: best, **leave}

    def best(self, cell: str) -> tuple[str, float]:
        """The quickest way of a cell and its rate."""
        way = max(self.rates, key=lambda way: self.rates[way][cell])
        return way, self.rates[way][cell]


@cache
def machine() -> Machine:
    """What was measured on this machine, now where that has not happened before. Processes that start at the same time
    measure once. Where nothing can be kept, the figures hold for this process.
    """
    path = cache_folder() / f"products-{_key()}.json"
    try:
        files.make_folder(path.parent)
        with _alone(path.with_suffix(".lock")):
            stored = _read(path)
            if stored is None:
                stored = measure()
                files.write_atomically(path, json.dumps(asdict(stored), indent=1).encode())
    except OSError:
        return measure()
    return stored


def cache_folder(environ: Mapping[str, str] = os.environ) -> Path:
    """Where measurements of this machine are kept."""
    return Path(environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "rrm"


def measure() -> Machine:
    """Have every way tried by a process of its own; one that dies takes nobody along."""
    from rrm.nets.ways import WAYS

    command = [sys.executable, "-m", "rrm.nets.tuning"]
    variables = environment() | dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    rates: dict[str, dict[str, float]] = {}
    refused: dict[str, str] = {}
    for way in WAYS:
        if way in rates or way in refused:
            continue
        rest = [name for name in WAYS if name not in rates and name not in refused]
        with subprocess.Popen(command + rest, stdout=subprocess.PIPE, text=True, env=variables) as process:
            assert process.stdout is not None
            for line in process.stdout:
                found = json.loads(line)
                if found["why"]:
                    refused[found["way"]] = found["why"]
                else:
                    rates[found["way"]] = found["rates"]
        if process.returncode and way not in rates:
            refused[way] = _ending(process.returncode)
    return Machine(rates, refused)


def _ending(code: int) -> str:
    return f"trying it ended by {signal.Signals(-code).name}" if code < 0 else f"trying it ended with exit code {code}"


def main(names: list[str]) -> None:
    """Try the ways of these names in turn."""
    import torch

    torch.set_num_threads(1)
    for name in names:
        rates, why = _try(name)
        print(json.dumps({"way": name, "rates": rates, "why": why}), flush=True)  # noqa: T201


def _try(name: str) -> tuple[dict[str, float], str]:
    """Rates of one way by cell, and why it is not to be taken; empty where it is."""
    import torch

    from rrm.nets.products import FORMS, SHAPES, cell
    from rrm.nets.ways import WAYS, MklKernel

    way = WAYS[name]
    if isinstance(way, MklKernel) and not way.there():
        return {}, "this processor or this torch does not have it"
    rates = {}
    generator = torch.Generator().manual_seed(0)
    for rows, inputs, outputs in SHAPES:
        x, d = (torch.randn(1, rows, width, generator=generator) for width in (inputs, outputs))
        w = torch.randn(1, inputs, outputs, generator=generator)
        for form in FORMS:
            a, b = {"forward": (x, w), "weights": (x.mT, d), "inputs": (d, w.mT)}[form]
            out = torch.empty(1, a.shape[1], b.shape[2])
            work = way(a, b, out)
            work()
            error = (out - a.double() @ b.double()).abs().max().item()
            if error > 2.0**-15 * math.sqrt(a.shape[2]):
                return {}, f"its products round: {cell(form, (rows, inputs, outputs))} is wrong by {error:.1g}"
            rates[cell(form, (rows, inputs, outputs))] = 2.0 * rows * inputs * outputs / _seconds(work)
    return rates, ""


def _seconds(work: Callable[[], Any]) -> float:
    """The best of a few turns, a call."""
    best = math.inf
    for _ in range(_TURNS):
        calls, start = 0, time.perf_counter()
        while (passed := time.perf_counter() - start) < _TURN_S or not calls:
            work()
            calls += 1
        best = min(best, passed / calls)
    return best


def _key() -> str:
    """Of this processor and these libraries."""
    from importlib.metadata import version

    facts = (cpu_model(), sorted(extensions()), version("torch"), version("numpy"), _sources())
    return hashlib.sha256(repr(facts).encode()).hexdigest()[:16]


def _sources() -> str:
    """Of what measures: a change of it measures anew."""
    here = Path(__file__).parent
    return hashlib.sha256(b"".join((here / f"{name}.py").read_bytes() for name in ("products", "tuning", "ways"))).hexdigest()


def _read(path: Path) -> Machine | None:
    """What is kept; None where there is nothing, or nothing that can be read."""
    try:
        stored = json.loads(files.read_bounded(path, 1 << 20))
        return Machine(**stored)
    except (OSError, ValueError, TypeError):
        return None


@contextmanager
def _alone(path: Path) -> Iterator[None]:
    """While inside, no other process of this machine is."""
    with path.open("a") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


if __name__ == "__main__":
    main(sys.argv[1:])
