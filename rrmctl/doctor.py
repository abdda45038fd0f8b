"""Is this machine ready? Each check says what it found and, where something is missing, the command that mends it."""

from __future__ import annotations

import fcntl
import os
import platform
import shlex
import shutil
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from rrm import devices
from rrm.environ import run_python
from rrm.envs.tasks import wheels
from rrm.errors import RenderingError
from rrm.hardware import cpu_model, extensions, usable_cores
from rrm.rendering import INSTALL, renderer
from rrm.tuning import CONVOLUTIONS, EXACT, OTHERWISE, ROUNDED, Machine, Shape, cell, in_words, kept_in, machine, pays
from rrmctl.errors import UserError
from rrmctl.planning import card_rates
from rrmctl.planning.experiments import SHIPPED, available
from rrmctl.store.mounts import Mount, mount_of
from rrmctl.store.owner import LEASE_S, NETWORK_LEASE_S

if TYPE_CHECKING:
    from packaging.requirements import Requirement

DISTRIBUTION = "rrmctl"

#: Below this the final networks and checkpoints of a sweep may not fit.
_DISK_NEEDED = 2 * 1024**3

_ELSEWHERE = "choose a folder with --results DIR"

#: Layers of the paper's networks and of a laptop's: batch, inputs, outputs.
_LARGE, _SMALL = (512, 256, 256), (128, 128, 128)

#: Prints how many pictures a second a task's camera takes.
_SPEED = """
import time
from rrm.envs import make, task
env, space = make("button-press-image"), task("button-press-image").spaces.frames
env.reset(seed=0)
env.frame(space)
begin = time.perf_counter()
for _ in range(20):
    env.frame(space)
print(20 / (time.perf_counter() - begin))
env.close()
"""


@dataclass(frozen=True)
class Check:
    """One line of the report. A `note` is worth knowing and stops nothing."""

    name: str
    state: Literal["ok", "note", "missing"]
    found: str
    fix: str = ""


def _needed(name: str, fits: bool, found: str, fix: str) -> Check:
    return Check(name, "ok", found) if fits else Check(name, "missing", found, fix)


def examine(results: Path, experiments: Path | None) -> Iterator[Check]:
    """Every check in turn, of the places of runs and of manifests too; some take a second or two each."""
    try:
        yield from packages()
    except metadata.PackageNotFoundError:  # a clone that is run as it is
        fix = f"{Path(sys.executable).name} -m pip install --editable {Path(__file__).parents[1]}"
        yield Check(DISTRIBUTION, "missing", "not installed, so that nobody knows what it needs", fix)
    problem = _try("import mujoco, metaworld, dm_control.suite, gymnasium, torch")  # installed need not mean it loads
    state = problem or "mujoco, Meta-World, DM-Control and torch load"
    yield _needed("simulators", problem is None, state, "reinstall: pip install --force-reinstall the package it names")
    yield Check("cores", "ok", f"{usable_cores()} usable of {os.cpu_count()} ({cpu_model()}); one job keeps one busy")
    yield Check("threads", "ok", "one per worker, whatever is set in this shell")
    yield from arithmetic()
    yield from graphics()
    yield from folders(results, experiments)
    yield rendering()


def packages() -> Iterator[Check]:
    """Python and every required package at an accepted version; simulated robots' as a note."""
    from packaging.requirements import Requirement
    from packaging.specifiers import SpecifierSet

    wanted, version = metadata.metadata(DISTRIBUTION)["Requires-Python"], platform.python_version()
    fits = SpecifierSet(wanted).contains(version, prereleases=True)
    state = f"{version} ({sys.executable})" if fits else f"{version}, but {DISTRIBUTION} needs {wanted}"
    yield _needed("python", fits, state, "install Python 3.11 or 3.12")
    for text in metadata.requires(DISTRIBUTION) or []:
        requirement = Requirement(text)
        extra = requirement.marker is not None and not requirement.marker.evaluate({"extra": ""})
        if not extra or _of_extra(requirement, "robot"):  # the others are tools of developers
            yield package(requirement.name, str(requirement.specifier), extra="robot" if extra else None)


def _of_extra(requirement: Requirement, extra: str) -> bool:
    return requirement.marker is not None and requirement.marker.evaluate({"extra": extra})


def package(name: str, specifier: str, *, extra: str | None = None) -> Check:
    """A package must be installed, at a version that `specifier` accepts; a note where an extra of ours brings it."""
    from packaging.specifiers import SpecifierSet

    try:
        version = metadata.version(name)
        if SpecifierSet(specifier).contains(version, prereleases=True):
            return Check(name, "ok", version)
        found = f"{version}, but {specifier} is needed"
    except metadata.PackageNotFoundError:
        found = "not installed" if extra is None else f"not installed; the tasks panda-* alone need it{wheels(name)}"
    what = f"{name}{specifier}" if extra is None else f"{DISTRIBUTION}[{extra}]"
    fix = shlex.join([sys.executable, "-m", "pip", "install", what])
    return Check(name, "missing" if extra is None else "note", found, fix)


def arithmetic(cpuinfo: Path = Path("/proc/cpuinfo")) -> Iterator[Check]:
    """Which ways the products of networks go, and whether bfloat16 is there and pays; measured where nobody has yet."""
    try:
        here = machine()
    except RuntimeError as error:
        yield Check(
            "products", "missing", str(error).splitlines()[-1], "reinstall: pip install --force-reinstall torch"
        )
        return
    best, large = here.choice[OTHERWISE], cell("forward", _LARGE)
    quickest = f"{in_words(here.choice)}; {_rate(here.rates[best][large])} at {_sides(_LARGE)} forward"
    beside = "" if best == "torch" else f", torch by itself {_rate(here.rates['torch'][large])}"
    refused = [f"; not {way}: {reason}" for way, reason in here.refused.items() if way in EXACT]
    found, file = "".join([quickest, beside, *refused]), kept_in()
    if file.is_file():
        yield Check("products", "ok", found)
    else:
        lost = f"; not kept, {file.parent} cannot be written: every run measures again"
        yield Check("products", "note", found + lost, "set XDG_CACHE_HOME to a folder that can be written")
    yield Check("precision", "ok", "; ".join([*_precision(here), _vectors(extensions(cpuinfo))]))


def _precision(here: Machine) -> Iterator[str]:
    if ROUNDED in here.refused:
        yield f"float32; not {ROUNDED}: {here.refused[ROUNDED]}"
        return
    yield f"float32 or {ROUNDED}"
    measured = {f"at {_sides(shape)}": here.layer(shape) for shape in (_LARGE, _SMALL)}
    measured |= {f"on images, {channels} channels": here.seeing(channels) for channels in reversed(CONVOLUTIONS)}
    for what, (exact, rounded) in measured.items():
        meant = ROUNDED if pays(exact, rounded) else "float32"
        yield f'"auto" is {meant} {what} ({ROUNDED} {_rate(rounded)}, float32 {_rate(exact)})'


def _vectors(flags: frozenset[str]) -> str:
    if not flags:
        return "this system does not tell its vector extensions"
    there = [name for name in ("avx2", "avx512f", "avx512_bf16", "amx_bf16", "asimd", "bf16") if name in flags]
    return f"vector extensions: {', '.join(there) or 'none known'}"


def _sides(shape: Shape) -> str:
    return "x".join(map(str, shape))


def _rate(rate: float) -> str:
    return f"{rate / 1e9:.0f} GFLOP/s"


def graphics() -> Iterator[Check]:
    """Graphics cards, what drives them, what torch can do with them, and how many runs each bears. None is needed."""
    here, driver, speaks, built = (
        devices.cards(),
        devices.driver_version(),
        devices.cuda_of_driver(),
        devices.cuda_of_torch(),
    )
    driven = f"driver {driver or 'of unknown version'}" + (f", which speaks CUDA {speaks}" if speaks else "")
    if not here and driver is None and speaks is None:
        fix = "where there is a card: install NVIDIA's driver; in a container, start that with its cards (--gpus all)"
        yield Check("cards", "note", "no NVIDIA driver is found: networks learn on the processor", fix)
        return
    if not here:
        fix = "is CUDA_VISIBLE_DEVICES set and empty? a container must be started with its cards (--gpus all)"
        yield Check("cards", "note", f"{driven}, but CUDA lists no card: networks learn on the processor", fix)
        return
    found = f"{', '.join(map(devices.in_words, here))}; {driven}"
    if built is None:
        fix = shlex.join([sys.executable, "-m", "pip", "install", "--force-reinstall", "torch"])
        yield Check("cards", "note", f"{found}; this torch is built without CUDA", f"{fix} (PyPI's has it on Linux)")
        return
    found += f"; torch is built for CUDA {built}"
    if speaks is not None and _major(speaks) < _major(built):
        fix = f"install a newer driver, or a torch for CUDA {_major(speaks)} (https://pytorch.org/get-started/locally)"
        yield Check("cards", "note", f"{found}: the driver is too old for it", fix)
        return
    service = "there (--mps)" if shutil.which("nvidia-cuda-mps-control") else "not installed"
    yield Check("cards", "ok", f"{found}; NVIDIA's MPS is {service}")
    for card in {(card.name, card.memory): card for card in here}.values():
        rates, by_mps = (card_rates.read(card, mps=mps) for mps in (False, True))
        if by_mps is not None:
            yield Check("runs on a card", "ok", f"{card.name}, with --mps: {card_rates.in_words(by_mps)}")
        if rates is None:
            unknown = f"{card.name}: nobody has measured how many it bears: one at a time, and plans know no times"
            yield Check("runs on a card", "note", unknown, "rrmctl doctor --tune")
        else:
            yield Check("runs on a card", "ok", f"{card.name}: {card_rates.in_words(rates)}")


def _major(version: str) -> int:
    return int(version.partition(".")[0])


def folders(results: Path, experiments: Path | None) -> Iterator[Check]:
    """Where runs are kept files can be written and locked, and there is room; there are manifests."""
    there = next((folder for folder in (results, *results.absolute().parents) if folder.exists()), Path("/"))
    try:
        with tempfile.NamedTemporaryFile(dir=there, prefix=".rrmctl-") as file:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            os.fsync(file.fileno())
        yield Check("results", "ok", f"{results} {'can be written' if results.exists() else 'can be made'}")
    except OSError as error:
        yield Check("results", "missing", f"{results}: {error.strerror}", _ELSEWHERE)
    yield mounted(mount_of(results))
    free = shutil.disk_usage(there).free
    room = f"{free / 1024**3:.1f} GB free for {results}"
    yield _needed("disk", free >= _DISK_NEEDED, room, "free 2 GB, or choose another disk with --results DIR")
    try:
        manifests = available(experiments).values()
    except UserError as error:
        yield Check("experiments", "missing", str(error), error.hint or "")
        return
    shipped = sum(path.resolve().parent == SHIPPED for path in manifests)
    counts = f"{shipped} of rrmctl, {len(manifests) - shipped} of yours"
    yield _needed("experiments", shipped > 0, counts, "reinstall rrmctl: those that come with it are gone")


def mounted(mount: Mount) -> Check:
    """What the results folder is on, and what follows where several machines share it."""
    if not mount.type:
        return Check("mount", "ok", "this system does not tell what the results folder is on")
    where = f"{mount.type} at {mount.point}"
    if mount.passing:
        gone = "container" if mount.type == "overlay" else "machine"
        return Check("mount", "note", f"{where}: what is kept there goes with the {gone}", _ELSEWHERE)
    lease = NETWORK_LEASE_S if mount.network else LEASE_S
    where += f", {'shared' if mount.network else 'local'}: runs of an owner silent for {lease:g} s are taken over"
    if not mount.unsure_locks:
        return Check("mount", "ok", where)
    found = f"{where}; {mount.unsure_locks}: locks may keep no other machine out. A run has one owner all the same"
    return Check("mount", "note", found, "begin sweeps of one name, and clean, on one machine at a time")


def rendering() -> Check:
    """Which OpenGL draws what a camera sees, and how fast; runs on states need none."""
    try:
        found = renderer()
        rate = float(run_python(_SPEED))
    except (RenderingError, RuntimeError) as error:
        reasons = str(error).removesuffix(f": {INSTALL}")
        return Check("rendering", "note", f"{reasons}; runs on states need none", INSTALL)
    return Check("rendering", "ok", f"{found.name}, by {found.backend}; {rate:.0f} pictures of 64 x 64 a second")


def _try(code: str) -> str | None:
    """The last line of what a fresh Python says about `code`; None where it runs."""
    try:
        run_python(code)
    except RuntimeError as error:
        return str(error)
    return None
