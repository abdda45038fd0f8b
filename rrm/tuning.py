"""Which way to a product is the quickest on this machine: measured once, by processes that may die of it.

`rrm.nets.trial` tries the ways, `rrm.nets.products` goes by what was found. The figures are kept in the user's cache
folder, for this processor and these libraries; another processor, torch or numpy is measured anew. Nothing here
imports torch.
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
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Literal

from rrm import files
from rrm.environ import environment
from rrm.hardware import cpu_model, extensions

Form = Literal["forward", "weights", "inputs"]
Shape = tuple[int, int, int]  #: rows, inputs and outputs of a layer
Choice = Mapping[str, str]  #: names of ways by `cell(form, shape)`, and by `OTHERWISE`

#: Of each layer there are three: x w, x' d for the gradient in w, and d w' for that in x.
FORMS: tuple[Form, ...] = ("forward", "weights", "inputs")

#: What is measured; a product goes the way of the nearest. Layers of a laptop's networks, of the paper's, of a reward's
#: and of an image agent's; narrow last layers, which are multiplied with their narrow side first; acting.
SHAPES: tuple[Shape, ...] = (
    (128, 43, 128), (128, 128, 128), (512, 43, 256), (512, 256, 256), (2048, 44, 256), (2048, 256, 256),
    (512, 1024, 1024), (128, 128, 1), (128, 128, 8), (512, 256, 1), (512, 256, 8),
    (8, 128, 128), (1, 512, 256), (8, 512, 256), (1, 2048, 256), (1, 128, 128),
)  # fmt: skip

#: The exact ways, in the order in which they are tried; those that rely on what is not documented come last.
EXACT = ("torch", "onednn", "numpy", "mkl-avx512", "mkl-avx2")

#: The way that rounds its factors to bfloat16.
ROUNDED = "bfloat16"

#: The key of the way that all products go whose own is not named.
OTHERWISE = "otherwise"

#: So much quicker must a way be for one product to leave the one that is the quickest over all: what is measured alone
#: says that much about what happens between other work.
_CLEARLY = 1.15

#: So much quicker than exact products must rounded ones be to pay: the rest of an update takes its time all the same.
_PAYS = 1.3


#: What a way does to its process that is not for this processor, or not what it is taken for.
_FAULTS = (signal.SIGSEGV, signal.SIGBUS, signal.SIGILL, signal.SIGFPE, signal.SIGABRT)


def cell(form: Form, shape: Shape) -> str:
    """The name of a measured product, such as `weights 512x256x256`."""
    return f"{form} {'x'.join(map(str, shape))}"


@cache
def nearest(shape: Shape) -> Shape:
    """The measured shape whose sides are closest in proportion."""

    def distance(other: Shape) -> float:
        return sum(abs(math.log(mine / theirs)) for mine, theirs in zip(shape, other, strict=True))

    return min(SHAPES, key=distance)


@dataclass(frozen=True)
class Machine:
    """What was measured here."""

    rates: Mapping[str, Mapping[str, float]]  #: operations a second, by way and cell
    refused: Mapping[str, str] = field(default_factory=dict)  #: why a way is not taken, by its name

    @property
    def choice(self) -> dict[str, str]:
        """The exact way that is the quickest over all cells, and those cells where another is clearly quicker."""
        exact = self._exact

        def mean(way: str) -> float:
            return sum(map(math.log, exact[way].values()))

        best = max(exact, key=mean)
        quickest = {cell: self.best(cell)[0] for cell in exact[best]}
        leave = {cell: way for cell, way in quickest.items() if exact[way][cell] > _CLEARLY * exact[best][cell]}
        return {OTHERWISE: best, **leave}

    def best(self, cell: str) -> tuple[str, float]:
        """The quickest exact way of a cell and its rate."""
        way = max(self._exact, key=lambda way: self.rates[way][cell])
        return way, self.rates[way][cell]

    def rounding_pays(self, shape: Shape) -> bool:
        """Whether products of a layer in bfloat16 are so much quicker than exact ones that they are worth it."""
        if ROUNDED not in self.rates:
            return False
        cells = [cell(form, nearest(shape)) for form in FORMS]
        gain = math.prod(self.rates[ROUNDED][name] / self.best(name)[1] for name in cells) ** (1 / len(cells))
        return gain >= _PAYS

    @property
    def _exact(self) -> dict[str, Mapping[str, float]]:
        return {way: rates for way, rates in self.rates.items() if way != ROUNDED}


@cache
def machine() -> Machine:
    """What was measured on this machine, now where that has not happened before. Processes that start at the same time
    measure once. Where nothing can be kept, the figures hold for this process.
    """
    path = _folder() / f"products-{_key()}.json"
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


def measure() -> Machine:
    """Have every way tried by another process; one that dies of a way goes on with the next in a new one.

    Raises RuntimeError with what it said where the process fails otherwise.
    """
    rates: dict[str, dict[str, float]] = {}
    refused: dict[str, str] = {}
    variables = environment() | dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    rest = [*EXACT, ROUNDED]
    while rest:
        command = [sys.executable, "-m", "rrm.nets.trial", *rest]
        done = subprocess.run(command, capture_output=True, text=True, env=variables, check=False)
        for line in done.stdout.splitlines():
            found = json.loads(line)
            rest.remove(found["way"])
            if found["refused"]:
                refused[found["way"]] = found["refused"]
            else:
                rates[found["way"]] = found["rates"]
        if -done.returncode in _FAULTS and rates:
            refused[rest.pop(0)] = f"trying it ended by {signal.Signals(-done.returncode).name}"
        elif done.returncode:
            raise RuntimeError(f"products could not be measured (exit code {done.returncode}): {done.stderr}")
    return Machine(rates, refused)


def _folder(environ: Mapping[str, str] = os.environ) -> Path:
    """Where measurements of this machine are kept."""
    return Path(environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "rrm"


def _key() -> str:
    """Of this processor, these libraries, and what is measured how."""
    here = Path(__file__).parent
    sources = [(here / name).read_bytes() for name in ("tuning.py", "nets/program.py", "nets/trial.py", "nets/ways.py")]
    facts = (cpu_model(), sorted(extensions()), version("torch"), version("numpy"), *sources)
    return hashlib.sha256(repr(facts).encode()).hexdigest()[:16]


def _read(path: Path) -> Machine | None:
    """What is kept; None where there is nothing, or nothing that can be read."""
    try:
        return Machine(**json.loads(files.read_bounded(path, 1 << 20)))
    except (OSError, ValueError, TypeError):
        return None


@contextmanager
def _alone(path: Path) -> Iterator[None]:
    """While inside, no other process of this machine is."""
    with path.open("a") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield
