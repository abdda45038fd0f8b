"""A run multiplies to its end as it began, whatever the machine it goes on with has measured meanwhile."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path

import pytest

from rrm.tuning import OTHERWISE, Machine, kept_in, machine
from rrmctl.running.worker import WorkerExit
from rrmctl.store.layout import RunFolder
from rrmctl.store.provenance import made_with, read_provenance
from tests.rrmctl.running.test_torn import STEPS, numbers, prepared

pytestmark = pytest.mark.slow

#: A worker that is told to stop after so many steps; none: one as it is.
STOPPING = "import sys; from pathlib import Path; from rrmctl.store.layout import Layout; "
STOPPING += "from tests.rrmctl.running.test_torn import work; root, run, steps = sys.argv[1:]; "
STOPPING += "sys.exit(work(Layout(Path(root)).run(run), stop_at=int(steps)))"
ROOT = Path(__file__).parents[3]


def measured(cache: Path, *ways: str) -> Path:
    """A cache folder of this machine where these ways alone were found, the first the quickest of all."""
    cells = machine().rates["torch"]
    found = Machine(
        {way: dict.fromkeys(cells, 1e9 / 2**at) for at, way in enumerate(dict.fromkeys((*ways, "torch")))}, {}
    )
    path = kept_in({**os.environ, "XDG_CACHE_HOME": str(cache)})
    path.parent.mkdir(parents=True)
    path.write_text(json.dumps(asdict(found)))
    return cache


def work(folder: RunFolder, cache: Path, stop_at: int | None = None) -> str:
    """What a worker process with this cache says; it ends as it should."""
    where = [str(folder.path.parents[1]), folder.id]
    whole = ["-m", "rrmctl.running.worker", *where]
    command = [sys.executable, *(whole if stop_at is None else ["-c", STOPPING, *where, str(stop_at)])]
    own = os.environ | {"XDG_CACHE_HOME": str(cache)}
    done = subprocess.run(command, env=own, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == (WorkerExit.DONE if stop_at is None else WorkerExit.STOPPED), done.stderr
    return done.stdout


def recorded(folder: RunFolder) -> dict[str, str]:
    return (read_provenance(folder) or {})["products"]


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, str]:
    """The numbers of a run that is made by numpy from start to end."""
    root = tmp_path_factory.mktemp("whole")
    folder = prepared(root)
    work(folder, measured(root / "cache", "numpy"))
    assert recorded(folder) == {OTHERWISE: "numpy"}
    return numbers(folder)


def test_a_resumed_run_keeps_its_choice(tmp_path: Path, undisturbed: tuple[str, str]) -> None:
    """The same curve and networks, and no change to tell, though another way is the quickest by now."""
    folder = prepared(tmp_path)
    work(folder, measured(tmp_path / "first", "numpy"), stop_at=STEPS[1])
    said = work(folder, measured(tmp_path / "second", "torch", "numpy"))
    assert "continuing from the checkpoint" in said
    assert "differs" not in said
    assert numbers(folder) == undisturbed
    assert recorded(folder) == {OTHERWISE: "numpy"}
    assert made_with(read_provenance(folder))["products"] == "numpy"


def test_a_way_that_is_gone_is_replaced_and_told(tmp_path: Path) -> None:
    """The run goes on with the machine's own choice, and its provenance says from when on."""
    folder = prepared(tmp_path)
    work(folder, measured(tmp_path / "first", "numpy"), stop_at=STEPS[1])
    said = work(folder, measured(tmp_path / "second", "torch"))
    assert "differs from the attempt before: products: numpy -> torch\n" in said
    assert "continuing from the checkpoint" in said
    assert recorded(folder) == {OTHERWISE: "numpy"}
    assert made_with(read_provenance(folder))["products"] == "numpy, then torch"


@pytest.mark.long
def test_a_run_from_before_there_was_a_choice_goes_torch_s_way(tmp_path: Path) -> None:
    """As it did until then."""
    folder = prepared(tmp_path)
    work(folder, measured(tmp_path / "first", "torch"), stop_at=STEPS[1])
    content = json.loads(folder.provenance.read_text())
    del content["products"], content["checksum"]
    folder.provenance.write_text(json.dumps(content))
    said = work(folder, measured(tmp_path / "second", "numpy"))
    assert "differs" not in said
    assert made_with(read_provenance(folder))["products"] == "torch"
