"""The project as others get it: built and installed, or taken as it lies there."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import venv
from importlib import metadata
from pathlib import Path

import pytest
from packaging.requirements import Requirement

import rrm

ROOT = Path(__file__).parents[1]
PACKAGES = ("rrm", "rrmctl")
SMOKE = ["run", "toy-car", "--profile", "smoke", "--seeds", "1", "--methods", "oracle", "--workers", "1"]


def call(folder: Path, *command: str | Path) -> str:
    asked = {"cwd": folder, "env": os.environ | {"COLUMNS": "200"}}
    done = subprocess.run(command, **asked, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{command}: {done.stdout}{done.stderr}"
    return done.stdout


def sources(folder: Path) -> set[str]:
    """What belongs to the packages and the experiments, by its place in the wheel."""
    there = [path for name in (*PACKAGES, "experiments") for path in (folder / name).rglob("*") if path.is_file()]
    places = (path.relative_to(folder) for path in there if "__pycache__" not in path.parts)
    return {f"rrmctl/{path}" if path.parts[0] == "experiments" else str(path) for path in places}


def versions(results: Path) -> set[str]:
    """Which version of this project made the runs."""
    records = [json.loads(path.read_bytes()) for path in results.glob("runs/*/provenance.json")]
    return {record["versions"]["rrmctl"] for record in records}


@pytest.mark.parametrize(("python", "wheel"), [("3.11", True), ("3.12", False)])
def test_developers_build_no_simulator(python: str, wheel: bool) -> None:
    """PyBullet is asked for where it has a wheel: building it takes a compiler and ten minutes."""
    asked = [Requirement(text) for text in metadata.requires("rrmctl") or []]
    here = {"extra": "dev", "python_version": python}
    names = {one.name for one in asked if one.marker is None or one.marker.evaluate(here)}
    assert {"torch", "pytest"} < names
    assert ("pybullet" in names) == wheel


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An environment that holds the wheel, built of the source distribution; what it needs is this environment's."""
    folder = tmp_path_factory.mktemp("package")
    call(ROOT, sys.executable, "-m", "hatchling", "build", "-t", "sdist", "-d", folder)
    with tarfile.open(next(folder.glob("*.tar.gz"))) as archive:
        archive.extractall(folder, filter="data")
    (source,) = folder.glob("rrmctl-*/")
    assert {"rrm/py.typed", "rrmctl/py.typed"} < sources(source) == sources(ROOT)
    call(source, sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", folder)
    venv.create(folder / "venv", with_pip=True)
    python = folder / "venv" / "bin" / "python"
    call(folder, python, "-m", "pip", "install", "--no-deps", "--no-index", next(folder.glob("*.whl")))
    place = Path(call(folder, python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))").strip())
    assert {path for path in sources(ROOT) if not (place / path).is_file()} == set()
    shared = [path for path in sys.path if "site-packages" in path]
    (place / "shared.pth").write_text("\n".join(shared))
    return python.parent


@pytest.mark.slow
def test_what_is_installed_runs_anywhere(installed: Path, tmp_path: Path) -> None:
    """In an empty folder the wheel's program lists, plans, runs, reports and draws, all of one version."""
    rrmctl = installed / "rrmctl"
    assert "main-results" in call(tmp_path, rrmctl, "list")
    assert "1 jobs, none run yet" in call(tmp_path, rrmctl, "plan", *SMOKE[1:-2])
    call(tmp_path, rrmctl, *SMOKE)
    assert "oracle" in call(tmp_path, rrmctl, "report", "iqm", "toy-car")
    assert "toy-car-smoke.png" in call(tmp_path, rrmctl, "plot", "toy-car")
    call(tmp_path, rrmctl, "report", "html")
    assert call(tmp_path, rrmctl, "--version") == f"rrmctl {rrm.__version__}\n"
    assert call(tmp_path, installed / "python", "-m", "rrmctl", "--version") == f"rrmctl {rrm.__version__}\n"
    assert versions(tmp_path / "results") == {rrm.__version__}
    where = call(tmp_path, installed / "python", "-c", "import rrm, rrmctl; print(rrm.__file__, rrmctl.__file__)")
    assert str(ROOT) not in where


@pytest.mark.slow
def test_a_clone_runs_as_it_lies_there(tmp_path: Path) -> None:
    """Its sources make the runs, whatever is installed, and its version is theirs: --version's and the record's."""
    for name in (*PACKAGES, "experiments"):
        shutil.copytree(ROOT / name, tmp_path / name, ignore=shutil.ignore_patterns("__pycache__"))
    source = tmp_path / "rrm" / "__init__.py"
    source.write_text(re.sub(r'__version__ = ".*"', '__version__ = "99.1"', source.read_text()))
    rrmctl = (sys.executable, "-m", "rrmctl")
    assert call(tmp_path, *rrmctl, "--version") == "rrmctl 99.1\n"
    call(tmp_path, *rrmctl, *SMOKE)
    assert versions(tmp_path / "results") == {"99.1"}
    call(tmp_path, *rrmctl, "report", "html")
    assert "Written by rrmctl 99.1" in (tmp_path / "report.html").read_text()
    call(tmp_path, *rrmctl, "export", "toy-car", "--to", "csv", "-o", "out")
    assert json.loads((tmp_path / "out" / "datapackage.json").read_bytes())["generator"]["rrmctl"] == "99.1"
