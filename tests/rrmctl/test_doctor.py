"""The doctor: what it finds on a sound machine, and what it says where something is missing."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import islice
from pathlib import Path

import pytest

from rrmctl import doctor
from rrmctl.planning.experiments import SHIPPED


def test_required_packages_are_found() -> None:
    """Every requirement of the project is checked, and this environment meets them."""
    found = {check.name: check for check in doctor.packages()}
    assert {"python", "torch", "metaworld", "dm-control", "pyarrow", "pybullet"} <= set(found)
    assert "pytest" not in found
    assert all(check.state == "ok" for name, check in found.items() if name != "pybullet")


def test_absent_and_wrong_packages() -> None:
    """A package that is absent or of another version is missing, with the command that installs it."""
    absent = doctor.package("no-such-package", ">=1", needed=True)
    assert (absent.state, absent.found) == ("missing", "not installed")
    assert absent.fix.endswith("-m pip install 'no-such-package>=1'")
    wrong = doctor.package("numpy", "<1", needed=True)
    assert wrong.state == "missing"
    assert "<1 is needed" in wrong.found
    assert doctor.package("no-such-package", ">=1", needed=False).state == "note"


def test_a_clone_that_is_not_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a record of its own needs, the first thing said is how to install it; the other checks follow."""
    monkeypatch.setattr(doctor, "DISTRIBUTION", "no-such-package")
    first, second = islice(doctor.examine(Path("results"), None), 2)
    assert (first.state, second.name) == ("missing", "simulators")
    assert "-m pip install --editable" in first.fix


def test_rendering_is_a_note() -> None:
    """Without an OpenGL backend there is a note with the fix: runs on states need none."""
    check = doctor.rendering(("no-such-backend",))
    assert check.state == "note"
    assert "no-such-backend" in check.found
    assert "apt-get install" in check.fix


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


def test_vector_extensions(tmp_path: Path) -> None:
    """Formats the processor computes in are read from the system's description, where it has one."""
    info = tmp_path / "cpuinfo"
    info.write_text("processor\t: 0\nflags\t\t: fpu sse2 avx2 amx_bf16\n")
    assert doctor.precision(info).found == "float32 or bfloat16; vector extensions: avx2, amx_bf16"
    assert "does not tell" in doctor.precision(tmp_path / "absent").found
