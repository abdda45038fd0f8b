"""What the benchmarks' table says of its figures, and that the contestants do the work they are timed at."""

from __future__ import annotations

import io
import os
import re
import subprocess
import sys
import threading
import tomllib
from importlib.util import find_spec
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from rich.console import Console

from benchmarks import drqv2_update, images
from benchmarks.__main__ import table
from benchmarks.lines import Line, one_core, peak_mib
from benchmarks.sac_update import best_products, peers
from rrm.config import DrqConfig, SacConfig
from rrm.hardware import cpu_model

ROOT = Path(__file__).parents[1]
TINY = SacConfig(hidden=8, layers=1, batch=8)


@pytest.mark.parametrize(
    ("ours", "unit", "best", "ratio"),
    [(60.0, "/s", "ours", 1.5), (30.0, "/s", "fast", 0.75), (20.0, "ms", "ours", 1.5), (60.0, "ms", "slow", 0.5)],
)
def test_the_best_peer_counts(ours: float, unit: str, best: str, ratio: float) -> None:
    """Of rates the greatest, of times the least, whatever the order of the peers."""
    for others in ({"slow": 30.0, "fast": 40.0}, {"fast": 40.0, "slow": 30.0}):
        line = Line(item="an item", ours=ours, unit=unit, peers=others, least_ratio=1.0)
        assert (line.best, line.ratio, line.met) == (best, pytest.approx(ratio), ratio >= 1)


def test_a_demand_beside_nobody_is_not_judged() -> None:
    line = Line(item="an item", ours=1.0, unit="/s", least_ratio=1.0)
    assert (line.best, line.ratio, line.met) == ("", None, None)


def test_the_table_names_everybody() -> None:
    """The processor, each peer with its figure, and the best of the row."""
    console = Console(width=200, record=True, file=io.StringIO())
    console.print(table([Line(item="an item", ours=60, unit="/s", peers={"one": 80.0, "another": 40.0})]))
    text = console.export_text()
    assert cpu_model() in text
    assert re.search(r"60 /s .* 80 /s \(one\) .* one .* 0\.75 ", text)
    assert "40 /s (another)" in text


@pytest.mark.skipif(sys.platform != "linux", reason="cores can be chosen on Linux only")
def test_on_one_core_and_back() -> None:
    """Threads that were there before, those born inside, and the caller's own."""
    before, go, seen = os.sched_getaffinity(0), threading.Event(), []

    def look() -> None:
        go.wait()
        seen.append(os.sched_getaffinity(0))

    early = threading.Thread(target=look, daemon=True)
    early.start()
    with one_core():
        late = threading.Thread(target=look, daemon=True)
        late.start()
        go.set()
        early.join()
        late.join()
        core = os.sched_getaffinity(0)
    assert len(core) == 1
    assert seen == [core, core]
    assert os.sched_getaffinity(0) == before


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # other people's
def test_who_is_installed_takes_part() -> None:
    names = {"stable_baselines3": "Stable-Baselines3", "sbx": "SBX"}
    works = peers(TINY)
    assert set(works) == {"autograd, fused Adam"} | {name for module, name in names.items() if find_spec(module)}
    for work in works.values():
        work()
    best_products(TINY, "float32")()


@pytest.mark.slow
def test_an_update_from_frames_is_timed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Beside plain autograd; the authors' code takes part where its folder is named."""
    monkeypatch.delenv("DRQV2", raising=False)
    tiny = DrqConfig(kind="drqv2", channels=2, strides=(2, 2), hidden=8, batch=2)
    for line in drqv2_update.lines((tiny,), budget=0.001):
        assert list(line.peers) == ["autograd"]
        assert line.ours > 0
        assert line.floor is not None


@pytest.mark.slow
@pytest.mark.sim
@pytest.mark.usefixtures("opengl")
@pytest.mark.long
def test_a_run_on_images_is_measured() -> None:
    """Every figure is there at a scale that says nothing, and its memory is that of a process of its own."""
    found = {line.item: line for line in images.lines(("smoke",), stored=300, budget=0.001, interval=1.0)}
    assert [line.unit for line in found.values()] == ["%", "/s", "/s", "%", "%", "MiB", "MiB", "ms"]
    assert all(line.ours > 0 for line in found.values())


@pytest.mark.skipif(sys.platform != "linux", reason="Linux tells a process' largest size")
def test_memory_is_that_of_the_process_itself() -> None:
    """However much the one that started it holds."""
    command = [sys.executable, "-c", "from benchmarks.lines import peak_mib; print(peak_mib())"]
    assert peak_mib() > 150
    assert float(subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.PIPE).stdout) < 100


def test_a_folder_without_the_authors_code_is_refused(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("DRQV2", str(tmp_path))
    with pytest.raises(ValueError, match=r"no drqv2\.py in .*; clone https"):
        drqv2_update.authors(drqv2_update.PAPER, 0.1)


def test_what_is_asked_for_is_pinned() -> None:
    """What `make` installs is in constraints.txt, at a version that pyproject.toml accepts."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    pins = dict(line.split("==") for line in lines if not line.startswith("#"))
    pins = {canonicalize_name(name): version for name, version in pins.items()}
    asked = [Requirement(text) for text in project["dependencies"] + extras["dev"] + extras["bench"]]
    for requirement in (one for one in asked if one.name != project["name"]):
        version = pins[canonicalize_name(requirement.name)]
        assert requirement.specifier.contains(version, prereleases=True), requirement
