"""The doctor: what it finds on a sound machine, and what it says where something is missing."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import islice
from pathlib import Path

import pytest

from rrm import devices, tuning
from rrm.devices import Card
from rrm.rendering import Renderer
from rrm.tuning import EXACT, FORMS, ROUNDED, SEEING, SHAPES, Machine, cell, measure
from rrmctl import doctor
from rrmctl.planning import card_rates
from rrmctl.planning.experiments import SHIPPED


def test_required_packages_are_found() -> None:
    """Every requirement of the project is checked, and this environment meets them."""
    checks = list(doctor.packages())
    found = {check.name: check for check in checks}
    assert len(found) == len(checks)
    assert {"python", "torch", "metaworld", "dm-control", "pyarrow", "pybullet"} <= set(found)
    assert "pytest" not in found
    assert all(check.state == "ok" for name, check in found.items() if name != "pybullet")


def test_absent_and_wrong_packages() -> None:
    """A package that is absent or of another version is missing, with the command that installs it."""
    absent = doctor.package("no-such-package", ">=1")
    assert (absent.state, absent.found) == ("missing", "not installed")
    assert absent.fix.endswith("-m pip install 'no-such-package>=1'")
    wrong = doctor.package("numpy", "<1")
    assert wrong.state == "missing"
    assert "<1 is needed" in wrong.found
    robot = doctor.package("no-such-package", ">=1", extra="robot")
    assert (robot.state, robot.fix.split(" install ")[1]) == ("note", "'rrmctl[robot]'")


@pytest.mark.slow
def test_a_clone_that_is_not_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a record of its own needs, the first thing said is how to install it; the other checks follow."""
    monkeypatch.setattr(doctor, "DISTRIBUTION", "no-such-package")
    first, second = islice(doctor.examine(Path("results"), None), 2)
    assert (first.state, second.name) == ("missing", "simulators")
    assert "-m pip install --editable" in first.fix


@pytest.mark.slow
@pytest.mark.sim
def test_rendering(opengl: Renderer) -> None:
    """What draws, and how fast."""
    check = doctor.rendering()
    assert (check.state, check.fix) == ("ok", "")
    assert re.fullmatch(
        rf"{re.escape(opengl.name)}, by {opengl.backend}; \d+ pictures of 64 x 64 a second", check.found
    )


def test_rendering_is_a_note(no_opengl: dict[str, str]) -> None:
    """Without OpenGL there is a note with the fix: runs on states need none."""
    code = "from rrmctl.doctor import rendering; print(*rendering().__dict__.values(), sep='|')"
    told = subprocess.run([sys.executable, "-c", code], env=no_opengl, capture_output=True, text=True, check=True)
    _, state, found, fix = told.stdout.strip().split("|")
    assert state == "note"
    assert "egl: " in found
    assert "apt-get" not in found
    assert fix.startswith("apt-get install libegl1")


def results_check(folder: Path) -> doctor.Check:
    return next(check for check in doctor.folders(folder, None) if check.name == "results")


def test_results_folder(tmp_path: Path) -> None:
    """A folder that exists can be written, one that does not can be made; nothing is left behind."""
    assert results_check(tmp_path).found.endswith("can be written")
    assert results_check(tmp_path / "a" / "b").found.endswith("can be made")
    assert list(tmp_path.iterdir()) == []


@contextmanager
def an_ordinary_user() -> Iterator[None]:
    """The superuser may write anywhere; inside, this process is nobody."""
    user = os.geteuid()
    if user == 0:
        os.seteuid(65534)
    try:
        yield
    finally:
        os.seteuid(user)


def test_unwritable_results_folder() -> None:
    """A folder that takes no file is missing, and another can be named."""
    with tempfile.TemporaryDirectory() as name:  # not pytest's, whose parents only their owner may enter
        Path(name).chmod(0o555)
        with an_ordinary_user():
            check = results_check(Path(name))
    assert check.state == "missing"
    assert "--results" in check.fix


def test_results_that_are_no_folder(tmp_path: Path) -> None:
    """A file where the results folder should be is missing."""
    (tmp_path / "results").write_text("")
    assert results_check(tmp_path / "results").state == "missing"


def test_experiments_folder(tmp_path: Path) -> None:
    """Manifests of the user's are counted beside those of rrmctl; a folder that is named must be there."""
    (tmp_path / "one.toml").write_text("")
    shipped = len(list(SHIPPED.glob("*.toml")))
    (check,) = [c for c in doctor.folders(tmp_path, tmp_path) if c.name == "experiments"]
    assert (check.state, check.found) == ("ok", f"{shipped} of rrmctl, 1 of yours")
    assert {c.name: c.state for c in doctor.folders(tmp_path, tmp_path / "no")}["experiments"] == "missing"


def test_shipped_manifests_are_known_from_where_they_are(monkeypatch: pytest.MonkeyPatch) -> None:
    """In the repository's own folder those that come with the program are not the user's."""
    monkeypatch.chdir(SHIPPED.parent)
    (check,) = [c for c in doctor.folders(Path("results"), None) if c.name == "experiments"]
    assert (check.state, check.found) == ("ok", f"{len(list(SHIPPED.glob('*.toml')))} of rrmctl, 0 of yours")


CELLS = [cell(form, shape) for form in FORMS for shape in SHAPES]


def measured(**rates: float) -> Machine:
    """A machine whose ways are so quick in GFLOP/s, and bfloat16 half of that for small batches."""
    found = {way.replace("_", "-"): dict.fromkeys(CELLS, 1e9 * rate) for way, rate in rates.items()}
    for name in found.get(ROUNDED, {}):
        found[ROUNDED][name] /= 1 if "512x" in name else 2
    found |= {SEEING["float32"]: {"16": 50e9, "32": 60e9}, SEEING["bfloat16"]: {"16": 60e9, "32": 90e9}}
    missing = dict.fromkeys([way for way in (*EXACT, ROUNDED) if way not in found], "this torch does not have it")
    return Machine(found, missing)


@pytest.fixture
def arithmetic(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Callable[..., dict[str, doctor.Check]]:
    """The checks of a machine with these rates, whose figures are kept."""
    kept, info = tmp_path / "kept", tmp_path / "cpuinfo"
    kept.touch()
    info.write_text("processor\t: 0\nflags\t\t: fpu sse2 avx2 amx_bf16\n")
    monkeypatch.setattr(doctor, "kept_in", lambda: kept)

    def examine(machine: Machine) -> dict[str, doctor.Check]:
        monkeypatch.setattr(doctor, "machine", lambda: machine)
        return {check.name: check for check in doctor.arithmetic(info)}

    return examine


def test_ways_of_products(arithmetic: Callable[..., dict[str, doctor.Check]]) -> None:
    """The quickest, torch's own beside it, what goes another way, and what is refused and why."""
    machine = measured(torch=110, numpy=130, mkl_avx2=120)
    machine.rates["torch"][CELLS[1]] = 1e12  # type: ignore[index]
    machine.refused["onednn"] = "trying it ended by SIGSEGV"  # type: ignore[index]
    found = arithmetic(machine)["products"]
    assert found.state == "ok"
    assert found.found == (
        "numpy; torch for 128x128x128 forward; 130 GFLOP/s at 512x256x256 forward, torch by itself 110 GFLOP/s; "
        "not onednn: trying it ended by SIGSEGV; not mkl-avx512: this torch does not have it"
    )
    assert arithmetic(measured(torch=130, numpy=120))["products"].found.startswith(
        "torch; 130 GFLOP/s at 512x256x256 forward; not onednn"
    )


def test_precisions(arithmetic: Callable[..., dict[str, doctor.Check]]) -> None:
    """Which are there, and what "auto" takes for large and small batches, with the rates that decide."""
    assert arithmetic(measured(torch=100, bfloat16=180))["precision"].found == (
        'float32 or bfloat16; "auto" is bfloat16 at 512x256x256 (bfloat16 180 GFLOP/s, float32 100 GFLOP/s); '
        '"auto" is float32 at 128x128x128 (bfloat16 90 GFLOP/s, float32 100 GFLOP/s); '
        '"auto" is bfloat16 on images, 32 channels (bfloat16 90 GFLOP/s, float32 60 GFLOP/s); '
        '"auto" is float32 on images, 16 channels (bfloat16 60 GFLOP/s, float32 50 GFLOP/s); '
        "vector extensions: avx2, amx_bf16"
    )
    without = arithmetic(measured(torch=100))["precision"].found
    assert without.startswith("float32; not bfloat16: this torch does not have it; vector")


def test_a_system_that_does_not_tell_its_extensions(tmp_path: Path) -> None:
    """Nothing is wrong with it."""
    assert [check.state for check in doctor.arithmetic(tmp_path / "absent")] == ["ok", "ok"]


def test_figures_that_cannot_be_kept(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A note, with the variable that names another place."""
    monkeypatch.setattr(doctor, "kept_in", lambda: tmp_path / "rrm" / "products.json")
    found = next(doctor.arithmetic())
    assert found.state == "note"
    assert f"not kept, {tmp_path / 'rrm'} cannot be written" in found.found
    assert "XDG_CACHE_HOME" in found.fix


def test_a_torch_that_does_not_compute(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """It is missing, with its last words; the checks behind it are made all the same."""
    monkeypatch.setattr(doctor, "machine", measure)
    monkeypatch.setattr(tuning, "TRIAL", (sys.executable, "-c", "import torch_that_is_broken"))
    (found,) = doctor.arithmetic()
    assert found.state == "missing"
    assert "No module named 'torch_that_is_broken'" in found.found


CARD = Card(0, "NVIDIA A", 80 * 2**30)


@pytest.fixture
def driven(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Callable[..., list[doctor.Check]]:
    """What is said of cards where these are the facts."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))

    def examine(
        cards: tuple[Card, ...] = (), driver: str | None = None, speaks: str | None = None, torch: str | None = None
    ) -> list[doctor.Check]:
        facts = {"cards": cards, "driver_version": driver, "cuda_of_driver": speaks, "cuda_of_torch": torch}
        for name, fact in facts.items():
            monkeypatch.setattr(devices, name, lambda fact=fact: fact)
        return list(doctor.graphics())

    return examine


def test_a_machine_without_a_card(driven: Callable[..., list[doctor.Check]]) -> None:
    """It is as good; what would make a card usable is said."""
    (check,) = driven(torch="12.8")
    assert (check.state, check.found) == ("note", "no NVIDIA driver is found: networks learn on the processor")
    assert "install NVIDIA's driver" in check.fix
    (check,) = driven(driver="550.54", torch="12.8")
    assert (check.state, check.found[:42]) == ("note", "driver 550.54, but CUDA lists no card: net")
    assert "CUDA_VISIBLE_DEVICES" in check.fix


def test_a_card_that_torch_cannot_use(driven: Callable[..., list[doctor.Check]]) -> None:
    """Torch is built without CUDA, or for a newer one than the driver speaks; a newer minor version is no matter."""
    (check,) = driven((CARD,), "550.54", "12.4")
    assert check.state == "note"
    assert check.found == (
        "cuda:0 (NVIDIA A, 80 GiB); driver 550.54, which speaks CUDA 12.4; this torch is built without CUDA"
    )
    assert "-m pip install --force-reinstall torch" in check.fix
    (check,) = driven((CARD,), "520.10", "11.8", "12.8")
    assert check.state == "note"
    assert check.found.endswith("torch is built for CUDA 12.8: the driver is too old for it")
    assert "install a newer driver" in check.fix
    assert driven((CARD,), "550.54", "12.4", "12.8")[0].state == "ok"


def test_a_card_that_is_ready(
    driven: Callable[..., list[doctor.Check]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its name, driver and CUDA, whether MPS is there, and how many runs each kind of card bears once that is known."""
    monkeypatch.setenv("PATH", str(tmp_path))
    found, bears = driven((CARD, CARD._replace(number=1)), "550.54", "12.4", "12.8")
    assert found.state == "ok"
    assert found.found == (
        "cuda:0 (NVIDIA A, 80 GiB), cuda:1 (NVIDIA A, 80 GiB); driver 550.54, which speaks CUDA 12.4; torch is built "
        "for CUDA 12.8; NVIDIA's MPS is not installed"
    )
    assert (bears.state, bears.fix) == ("note", "rrmctl doctor --tune")
    card_rates.keep(CARD, card_rates.Rates({1: 300.0, 2: 590.0, 4: 1000.0, 8: 1050.0}, 2**30))
    _, bears = driven((CARD,), "550.54", "12.4", "12.8")
    assert (bears.state, bears.found) == (
        "ok", "NVIDIA A: 4 runs at a time (1: 300, 2: 590, 4: 1,000, 8: 1,050 steps/s together; 1.0 GiB each)"
    )  # fmt: skip
