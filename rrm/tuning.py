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
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field
from functools import cache, cached_property
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from statistics import geometric_mean
from typing import Annotated, Literal

from pydantic import Field, TypeAdapter

from rrm import files
from rrm.environ import environment
from rrm.hardware import cpu_model, extensions

Form = Literal["forward", "weights", "inputs"]
Shape = tuple[int, int, int]  #: rows, inputs and outputs of a layer
Choice = Mapping[str, str]  #: names of ways by `cell(form, shape)`, and by `OTHERWISE`
Rate = Annotated[float, Field(gt=0, allow_inf_nan=False)]  #: operations a second

#: Of each layer there are three: x w, x' d for the gradient in w, and d w' for that in x.
FORMS: tuple[Form, ...] = ("forward", "weights", "inputs")

#: What is measured; a product goes the way of the nearest. Layers of a laptop's networks, of the paper's, of a reward's
#: and of an image agent's; narrow last layers, which are multiplied with their narrow side first.
SHAPES: tuple[Shape, ...] = (
    (128, 43, 128), (128, 128, 128), (512, 43, 256), (512, 256, 256), (2048, 44, 256), (2048, 256, 256),
    (512, 1024, 1024), (128, 128, 8), (512, 256, 8), (8, 128, 128), (8, 512, 256),
)  # fmt: skip

#: The exact ways, in the order in which they are tried; those that rely on what is not documented come last.
EXACT = ("torch", "onednn", "numpy", "mkl-avx512", "mkl-avx2")

#: The way that rounds its factors to bfloat16.
ROUNDED = "bfloat16"

#: Convolutions of agents that see frames, forward and back in one, in either precision.
SEEING = {"float32": "convolutions", "bfloat16": "convolutions-bfloat16"}

#: What is measured of them, by channels: those of the laptop profile's agents and of the paper's.
CONVOLUTIONS = (16, 32)

#: The key of the way that all products go whose own is not named.
OTHERWISE = "otherwise"

#: So much quicker must a way be for one product to leave the one that is the quickest over all: what is measured alone
#: says that much about what happens between other work.
_CLEARLY = 1.15

#: So much quicker than exact products must rounded ones be to pay: the rest of an update takes its time all the same.
_PAYS = 1.3

#: Tries the ways whose names follow.
TRIAL = (sys.executable, "-m", "rrm.nets.trial")

_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")

#: What the names of variables begin with that tell a library which instructions to use.
_STEERING = ("ATEN_", "DNNL_", "MKL_", "ONEDNN_", "OPENBLAS_")


#: What a way does to its process that is not for this processor, or not what it is taken for.
_FAULTS = (signal.SIGSEGV, signal.SIGBUS, signal.SIGILL, signal.SIGFPE, signal.SIGABRT, signal.SIGALRM)


def cell(form: Form, shape: Shape) -> str:
    """The name of a measured product, such as `weights 512x256x256`."""
    return f"{form} {'x'.join(map(str, shape))}"


def cells(way: str) -> set[str]:
    """The names of all that is measured of a way; of convolutions that is how many channels they have."""
    if way in SEEING.values():
        return set(map(str, CONVOLUTIONS))
    return {cell(form, shape) for form in FORMS for shape in SHAPES}


def pays(exact: float, rounded: float) -> bool:
    """Whether a rate in bfloat16 is so much greater than the exact one that it is worth it."""
    return rounded > _PAYS * exact


def in_words(choice: Choice) -> str:
    """A choice for people, such as `numpy; torch for 1x512x256, 8x512x256 forward/inputs`."""
    others: dict[str, dict[str, list[str]]] = {}
    for name, way in choice.items():
        if name != OTHERWISE:
            form, _, shape = name.partition(" ")
            others.setdefault(way, {}).setdefault(shape, []).append(form)
    return "; ".join([choice[OTHERWISE], *(f"{way} for {_layers(others[way])}" for way in sorted(others))])


def _layers(forms: Mapping[str, Sequence[str]]) -> str:
    """Forms by shape: which of a layer's products are meant; none is named where it is all of them."""
    return ", ".join(
        shape if len(forms[shape]) == len(FORMS) else f"{shape} {'/'.join(sorted(forms[shape]))}"
        for shape in sorted(forms)
    )


@cache
def nearest(shape: Shape) -> Shape:
    """The measured shape whose sides are closest in proportion."""

    def distance(other: Shape) -> float:
        return sum(abs(math.log(mine / theirs)) for mine, theirs in zip(shape, other, strict=True))

    return min(SHAPES, key=distance)


@dataclass(frozen=True)
class Machine:
    """What was measured here."""

    rates: Mapping[str, Mapping[str, Rate]]  #: by way and cell
    refused: Mapping[str, str] = field(default_factory=dict)  #: why a way is not taken, by its name

    @cached_property
    def choice(self) -> dict[str, str]:
        """The exact way that is the quickest over all cells, and those cells where another is clearly quicker."""
        exact = self._exact
        best = max(exact, key=lambda way: geometric_mean(exact[way].values()))
        quickest = {cell: self.best(cell)[0] for cell in exact[best]}
        leave = {cell: way for cell, way in quickest.items() if exact[way][cell] > _CLEARLY * exact[best][cell]}
        return {OTHERWISE: best, **leave}

    def keep(self, chosen: Choice | None) -> Choice:
        """A choice that was made before, where all its ways are here; else this machine's own."""
        return chosen if chosen and self._exact.keys() >= set(chosen.values()) else self.choice

    def best(self, cell: str) -> tuple[str, float]:
        """The quickest exact way of a cell and its rate."""
        way = max(self._exact, key=lambda way: self.rates[way][cell])
        return way, self.rates[way][cell]

    def layer(self, shape: Shape) -> tuple[float, float]:
        """Rates of a layer's three products together: exact, each in its best way, and rounded (0 where refused)."""
        cells = [cell(form, nearest(shape)) for form in FORMS]
        rounded = self.rates.get(ROUNDED, {})
        exact = geometric_mean(self.best(name)[1] for name in cells)
        return exact, geometric_mean(rounded[name] for name in cells) if rounded else 0.0

    def seeing(self, channels: int) -> tuple[float, float]:
        """Rates of convolutions, forward and back, of about so many channels: likewise."""
        measured = str(min(CONVOLUTIONS, key=lambda other: abs(math.log(channels / other))))
        exact, rounded = (self.rates.get(way, {}).get(measured, 0.0) for way in SEEING.values())
        return exact, rounded

    @property
    def _exact(self) -> dict[str, Mapping[str, float]]:
        return {way: rates for way, rates in self.rates.items() if way in EXACT}


@cache
def machine() -> Machine:
    """What was measured on this machine, now where that has not happened before. Processes that start at the same time
    measure once. Where nothing can be kept, the figures hold for this process.
    """
    path = kept_in()
    found = _read(path)
    if found is None:
        with suppress(OSError):
            files.make_folder(path.parent)
            with _alone(path.with_suffix(".lock")):
                found = _read(path) or measure()
                files.write_atomically(path, json.dumps(asdict(found), indent=1).encode())
    return found or measure()


def measure() -> Machine:
    """Have every way tried by another process; one that dies of a way goes on with the next in a new one.

    Raises RuntimeError with what it said where the process fails otherwise.
    """
    rates: dict[str, dict[str, float]] = {}
    refused: dict[str, str] = {}
    rest = [*EXACT, ROUNDED, *SEEING.values()]
    while rest:
        done = subprocess.run(
            [*TRIAL, *rest], capture_output=True, text=True, env=environment() | _ONE_THREAD, check=False
        )
        for line in done.stdout.splitlines():
            found = json.loads(line)
            rest.remove(found["way"])
            if found["refused"]:
                refused[found["way"]] = found["refused"]
            else:
                rates[found["way"]] = found["rates"]
        if rest and rates and -done.returncode in _FAULTS:
            refused[rest.pop(0)] = f"trying it ended by {signal.Signals(-done.returncode).name}"
        elif rest:
            raise RuntimeError(f"products could not be measured (exit code {done.returncode}): {done.stderr.strip()}")
    return Machine(rates, refused)


def kept_in(environ: Mapping[str, str] = os.environ) -> Path:
    """The file where the measurements of this processor and these libraries are kept, or would be."""
    here = Path(__file__).parent
    sources = [
        (here / name).read_bytes()
        for name in ("tuning.py", "nets/compiled.py", "nets/encoder.py", "nets/trial.py", "nets/ways.py")
    ]
    steering = sorted((n, value) for n, value in environ.items() if n.startswith(_STEERING) and n not in _ONE_THREAD)
    builds = [(version(name), _largest(name)) for name in ("torch", "numpy")]
    facts = (cpu_model(), sorted(extensions()), builds, steering, *sources)
    digest = hashlib.sha256(repr(facts).encode()).hexdigest()[:16]
    return _cache(environ) / "rrm" / f"products-{digest}.json"


def _largest(package: str) -> int:
    """Size of the largest library of a package that is not imported: two builds of one version are told apart by it."""
    spec = find_spec(package)
    assert spec is not None
    roots = [Path(root) for root in spec.submodule_search_locations or []]
    roots += [root.with_name(f"{root.name}.libs") for root in roots]
    return max(
        (file.stat().st_size for root in roots for file in (*root.glob("lib/*"), *root.glob("*.so*"))), default=0
    )


def _cache(environ: Mapping[str, str]) -> Path:
    if named := environ.get("XDG_CACHE_HOME"):
        return Path(named)
    try:
        return Path.home() / ".cache"
    except RuntimeError:  # nobody has a home: nothing can be kept
        return Path(os.devnull)


def _read(path: Path) -> Machine | None:
    """What is kept; None where there is nothing, or nothing that can be read."""
    try:
        found = TypeAdapter(Machine).validate_json(files.read_bounded(path, 1 << 20))
    except (OSError, ValueError):
        return None
    known = {EXACT[0]} <= found.rates.keys() <= {*EXACT, ROUNDED, *SEEING.values()}
    return found if known and all(rates.keys() == cells(way) for way, rates in found.rates.items()) else None


@contextmanager
def _alone(path: Path) -> Iterator[None]:
    """While inside, no other process of this machine is."""
    with path.open("a") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield
