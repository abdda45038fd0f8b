"""Every file of a run, torn or changed at many places: the run ends as if nothing had been, or says what it refuses."""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Mapping
from pathlib import Path

import pytest

from rrm.config import EvaluationConfig, ExplorationConfig, FeedbackConfig, RewardConfig, SacConfig
from rrm.training import jobs
from rrm.training.run_config import RunConfig
from rrm.tuning import Choice
from rrmctl.running.config_file import config_content
from rrmctl.running.monitor import RunMonitor
from rrmctl.running.worker import WorkerExit, main
from rrmctl.store.curve import read_curve
from rrmctl.store.layout import Layout, RunFolder
from rrmctl.store.provenance import record_config
from rrmctl.store.schema import TIMINGS

pytestmark = pytest.mark.slow

CONFIG = RunConfig(
    profile="test", task="toy-car", seed=0, steps=300, horizon=50,
    reward=RewardConfig(learner="pebble", prior="proxy", hidden=16, layers=1, epochs=2),
    agent=SacConfig(hidden=16, layers=1, batch=16),
    feedback=FeedbackConfig(every=100, batch=5, budget=10, segment=10),
    exploration=ExplorationConfig(seed_steps=60),
    evaluation=EvaluationConfig(every=60, episodes=1),
).canonical()  # fmt: skip

STEPS = (180, 200)
#: What a run that was interrupted between two evaluations holds: two checkpoints, and the logs behind them.
FILES = (
    "config.json", "provenance.json", "status.json", "curve.parquet",
    *(f"checkpoint/state-{step:012}.{suffix}" for step in STEPS for suffix in ("json", "safetensors")),
    "checkpoint/transitions.bin", "checkpoint/reward-000001.bin",
)  # fmt: skip
#: Where a file is cut or changed, as a share of its length.
PLACES = (0.0, 0.003, 0.03, 0.2, 0.5, 0.8, 0.97, 0.9999)


class Impatient:
    """The real trainer, told to stop at a step."""

    def __init__(self, stop_at: int | None = None) -> None:
        self._stop_at = stop_at

    def fingerprint(self, config: RunConfig) -> dict[str, str]:
        return jobs.fingerprint(config)

    def choose_products(self, earlier: Choice | None) -> Choice:
        return jobs.choose_products(earlier)

    def perform(self, config: RunConfig, folder: Path, monitor: RunMonitor, results: Mapping[str, Path]) -> bool:
        if self._stop_at is not None:
            left = self._stop_at

            def should_stop() -> bool:
                nonlocal left
                left -= 1
                return left <= 0

            monitor.should_stop = should_stop  # type: ignore[method-assign]
        return jobs.train(config, folder, monitor, results)


def work(folder: RunFolder, stop_at: int | None = None) -> WorkerExit:
    return main([str(folder.path.parents[1]), folder.id], Impatient(stop_at))


def numbers(folder: RunFolder) -> tuple[str, str]:
    """All rows but what the clock put into them, and the networks."""
    table = read_curve(folder)
    assert table is not None
    rows = str(table.drop_columns(list(TIMINGS)).to_pylist())
    return rows, hashlib.sha256(folder.model.read_bytes()).hexdigest()


def prepared(root: Path) -> RunFolder:
    folder = Layout(root).run(CONFIG.identity)
    record_config(folder, config_content(CONFIG))
    return folder


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, str]:
    folder = prepared(tmp_path_factory.mktemp("whole"))
    assert work(folder) is WorkerExit.DONE
    return numbers(folder)


@pytest.fixture(scope="module")
def interrupted(tmp_path_factory: pytest.TempPathFactory) -> RunFolder:
    folder = prepared(tmp_path_factory.mktemp("half"))
    assert work(folder, stop_at=STEPS[1]) is WorkerExit.STOPPED
    held = {str(path.relative_to(folder.path)) for path in folder.path.rglob("*") if path.is_file()}
    assert held >= set(FILES)
    assert held - set(FILES) == {"lock", "guard", "lease-1.json"}, "a file that this test does not know"
    return folder


@pytest.mark.parametrize("damage", ["cut", "changed"])
@pytest.mark.parametrize("file", FILES)
def test_a_damaged_file(
    file: str, damage: str, undisturbed: tuple[str, str], interrupted: RunFolder, tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    """The same curve and networks at the end, and never a traceback; only a configuration cannot be made again."""
    for place in PLACES:
        folder = Layout(tmp_path / str(place)).run(CONFIG.identity)
        shutil.copytree(interrupted.path, folder.path)
        path = folder.path / file
        data = bytearray(path.read_bytes())
        at = int(place * len(data))
        path.write_bytes(data[:at] if damage == "cut" else data[:at] + bytes([data[at] ^ 0x11]) + data[at + 1 :])
        capsys.readouterr()
        code, said = work(folder), "".join(capsys.readouterr())
        where = f"{file} {damage} at {at} of {len(data)}:\n{said}"
        assert "Traceback" not in said, where
        if file == "config.json" and code is WorkerExit.REFUSED:  # what the run is, only who asked for it knows
            assert path.name in said, where
            continue
        assert code is WorkerExit.DONE, where
        assert numbers(folder) == undisturbed, where
