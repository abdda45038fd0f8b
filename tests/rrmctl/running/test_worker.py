"""One worker, called in this process with a stand-in trainer: what it refuses, and what it leaves behind."""

from __future__ import annotations

import dataclasses
import json
import os
import signal
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import ClassVar

import pytest

from rrm import devices
from rrm.config import ConfigSection, FeedbackConfig, ImitationConfig, RewardConfig
from rrm.envs.tasks import TASKS, Task
from rrm.errors import RenderingError, RobotError
from rrm.training.kinds import JOBS, JobKind
from rrm.training.run_config import RunConfig
from rrm.tuning import OTHERWISE
from rrmctl.running.config_file import config_content, load_config
from rrmctl.running.monitor import RunMonitor
from rrmctl.running.worker import WorkerExit, main
from rrmctl.store import provenance, records
from rrmctl.store.curve import read_curve
from rrmctl.store.files import is_locked, try_lock
from rrmctl.store.layout import Layout, RunFolder
from rrmctl.store.provenance import record_config
from rrmctl.store.status import ErrorKind, RunState, Status, read_status, write_status
from tests.rrmctl.running.standin import OutOfMemoryError, Trainer, config, prepare


@pytest.fixture
def folder(tmp_path: Path) -> RunFolder:
    layout, assigned = prepare(tmp_path, range(1))
    return layout.run(assigned[0].id)


def work(folder: RunFolder, *options: str) -> WorkerExit:
    return main([str(folder.path.parents[1]), folder.id, *options], Trainer())


def steps(folder: RunFolder) -> list[int]:
    table = read_curve(folder)
    assert table is not None
    return table["step"].to_pylist()


def refusal(folder: RunFolder) -> str:
    """Why the worker refuses the run, as its status tells."""
    assert work(folder) is WorkerExit.REFUSED
    status = read_status(folder)
    assert status.state in (RunState.FAILED, RunState.INTERRUPTED)
    assert status.error is not None
    assert status.error.kind in (ErrorKind.REFUSED, ErrorKind.DAMAGED)
    return status.error.message


def test_a_run_from_start_to_end(folder: RunFolder, capsys: pytest.CaptureFixture[str]) -> None:
    """All rows, a status that says done, a free lock, and a log that says what happened."""
    assert work(folder) is WorkerExit.DONE
    assert steps(folder) == [10, 20, 30, 40]
    status = read_status(folder)
    assert (status.state, status.attempt, status.step, status.steps, status.rows) == (RunState.DONE, 1, 40, 40, 4)
    assert (status.success, status.true_return) == (0.5, 40.0)
    assert not is_locked(folder.lock)
    assert [line.split(", process")[0] for line in capsys.readouterr().out.splitlines()] == [
        "--- attempt 1",
        "--- from step 0",
        "--- done at step 40",
    ]


class Full(Trainer):
    """Finds no memory on its card."""

    error: ClassVar[Exception]

    def perform(self, *_: object) -> bool:
        raise self.error


@pytest.mark.parametrize(
    "error",
    [
        OutOfMemoryError("CUDA out of memory. Tried to allocate 2.00 GiB. Of the allocated memory 1 GiB is reserved."),
        RuntimeError("CUDA error: out of memory\nCompile with `TORCH_USE_CUDA_DSA`"),
        RuntimeError("CUDA error: CUBLAS_STATUS_ALLOC_FAILED when calling `cublasCreate(handle)`"),
    ],
)
def test_a_card_without_memory_is_told_with_the_remedy(folder: RunFolder, error: Exception) -> None:
    """It is no bug but a lack of memory, and another attempt may find some."""
    Full.error = error
    assert main([str(folder.path.parents[1]), folder.id], Full()) is WorkerExit.CRASHED
    status = read_status(folder)
    assert status.state is RunState.INTERRUPTED
    assert status.error is not None
    assert status.error.kind is ErrorKind.MEMORY
    told = str(error).splitlines()[0].partition(" Of the")[0].rstrip(".")
    remedy = "fewer runs to a card (--per-gpu), or a smaller agent.batch"
    assert status.error.message == f"the card's memory is full ({told}): {remedy}"


def test_a_run_on_a_card_where_there_is_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its own worker says what is missing, before it loads anything."""
    monkeypatch.setattr(devices, "cuda_of_torch", lambda: None)
    layout, (job,) = prepare(tmp_path, range(1), on_cards=range(1))
    assert main([str(tmp_path), job.id]) is WorkerExit.REFUSED
    error = read_status(layout.run(job.id)).error
    assert error is not None
    assert error.message.startswith("device: cuda cannot be used here: the torch that is installed is built without")


def test_a_finished_run_is_left_alone(folder: RunFolder) -> None:
    """Nothing is trained or written a second time."""

    def written() -> dict[Path, int]:
        return {path: path.stat().st_mtime_ns for path in folder.path.iterdir() if "lease" not in path.name}

    work(folder)
    before = written()
    assert work(folder) is WorkerExit.DONE
    assert written() == before


def test_fresh_removes_what_the_run_holds(folder: RunFolder) -> None:
    """The attempt goes on counting, the provenance begins anew. Two who ask for it at once get it once."""
    work(folder)
    for left in (folder.networks / "20.safetensors", folder.deployments / "20-01234567.parquet", folder.episodes):
        left.parent.mkdir(exist_ok=True)
        left.touch()
    for _ in range(2):
        assert work(folder, "--fresh", "1") is WorkerExit.DONE
        assert read_status(folder).attempt == 2
        assert not any(path.exists() for path in (folder.networks, folder.deployments, folder.episodes))
        assert json.loads(folder.provenance.read_text())["resumed"] == []


def test_a_removal_that_was_cut_short_is_completed(folder: RunFolder) -> None:
    """A worker that died while it removed the old run does not make the next one go on with the rest of it."""
    work(folder)
    folder.curve.unlink()
    write_status(folder, dataclasses.replace(read_status(folder), state=RunState.RUNNING, discard=True))
    assert work(folder) is WorkerExit.DONE
    assert steps(folder) == [10, 20, 30, 40]


def test_a_worker_that_died_just_before_saying_done_is_not_repeated(
    folder: RunFolder, capsys: pytest.CaptureFixture[str]
) -> None:
    """The last row and the networks are there: the run is over."""
    work(folder)
    write_status(folder, dataclasses.replace(read_status(folder), state=RunState.RUNNING))
    capsys.readouterr()
    assert work(folder) is WorkerExit.DONE
    assert read_status(folder).state is RunState.DONE
    assert "from step" not in capsys.readouterr().out


def test_a_run_that_somebody_owns_is_not_touched(folder: RunFolder) -> None:
    """The loser of a race leaves with a code of its own and writes nothing."""
    assert try_lock(folder.lock) is not None
    assert work(folder) is WorkerExit.LOCKED
    assert not folder.status.exists()


def test_an_id_without_configuration_makes_no_folder(tmp_path: Path) -> None:
    """A mistyped id is refused and leaves no trace."""
    assert main([str(tmp_path), "feedfacefeedface"], Trainer()) is WorkerExit.REFUSED
    assert not (tmp_path / "runs").exists()


def edited(path: Path) -> None:
    path.write_text(json.dumps(json.loads(path.read_text()) | {"seed": 7}))


@pytest.mark.parametrize(
    "damage", [Path.unlink, lambda path: path.write_text("{"), edited], ids=["gone", "torn", "edited"]
)
def test_a_configuration_that_is_gone_or_damaged_is_not_the_runs_end(
    folder: RunFolder, damage: Callable[[Path], object]
) -> None:
    """It is refused, and as soon as the file is written anew it is trained without being asked twice."""
    content = json.loads(folder.config.read_text())
    damage(folder.config)
    assert work(folder) is WorkerExit.REFUSED
    assert read_status(folder).state in (RunState.QUEUED, RunState.INTERRUPTED)
    record_config(folder, {name: value for name, value in content.items() if name != "checksum"})
    assert work(folder) is WorkerExit.DONE
    assert read_status(folder).error is None


def test_what_changed_since_the_last_attempt_is_said(
    folder: RunFolder, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Resuming in another environment goes on, and names both environments in log and provenance."""
    work(folder)
    folder.model.unlink()
    write_status(folder, dataclasses.replace(read_status(folder), state=RunState.INTERRUPTED))
    monkeypatch.setenv("STANDIN_WORLD", "2")
    work(folder)
    assert "differs from the attempt before: fingerprint.toy-car: 1 -> 2" in capsys.readouterr().out
    (resumed,) = json.loads(folder.provenance.read_text())["resumed"]
    assert resumed["changes"] == {"fingerprint.toy-car": ["1", "2"]}


@pytest.mark.parametrize("name", ["status.json", "provenance.json", "curve.parquet"])
def test_a_damaged_file_is_set_aside_and_the_run_goes_on(
    folder: RunFolder, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """What it told is told again, by the checkpoint or by training; the damage is said, and the bytes are kept."""
    work(folder)
    for number in (1, 2):
        folder.model.unlink()
        write_status(folder, dataclasses.replace(read_status(folder), state=RunState.INTERRUPTED))
        torn = (folder.path / name).read_bytes()[:-9]
        (folder.path / name).write_bytes(torn)
        capsys.readouterr()
        assert work(folder) is WorkerExit.DONE
        aside = f"{name}.corrupt-{number}"
        assert f"set aside as {aside}" in capsys.readouterr().out
        assert (folder.path / aside).read_bytes() == torn
        assert steps(folder) == [10, 20, 30, 40]
        assert read_status(folder).state is RunState.DONE


def test_a_run_of_another_version_is_refused_and_left_as_it_is(
    folder: RunFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is whole, and for another program: nothing is set aside or trained again."""

    def content() -> dict[str, bytes]:
        files = [path for path in folder.path.iterdir() if path.is_file() and "lease" not in path.name]
        return {path.name: path.read_bytes() for path in files}

    work(folder)
    before = content()
    monkeypatch.setattr(records, "SCHEMA_VERSION", 2)
    assert work(folder) is WorkerExit.REFUSED
    assert content() == before


@pytest.mark.parametrize("error", [RenderingError("nothing here draws"), RobotError("episode 3, 3 times in a row")])
def test_what_may_be_back_is_tried_again(folder: RunFolder, error: Exception) -> None:
    """OpenGL and a rig that were there when the run began: no failure yet, and the run goes on when they are back."""

    class Without(Trainer):
        def perform(self, *_arguments: object) -> bool:
            raise error

    assert main([str(folder.path.parents[1]), folder.id], Without()) is WorkerExit.CRASHED
    status = read_status(folder)
    assert status.error is not None
    assert (status.state, status.error.kind) == (RunState.INTERRUPTED, ErrorKind.CRASHED)
    assert str(status.error) == f"{type(error).__name__}: {error}"
    assert work(folder) is WorkerExit.DONE


@pytest.mark.parametrize("name", ["status.json", "curve.parquet", "provenance.json"])
def test_a_file_that_cannot_be_read_now_stops_the_sweep(folder: RunFolder, name: str) -> None:
    """Nothing is set aside: the next attempt goes on with what is there."""
    work(folder)
    folder.model.unlink()
    write_status(folder, dataclasses.replace(read_status(folder), state=RunState.INTERRUPTED))
    path, hidden = folder.path / name, folder.path / "hidden"
    path.rename(hidden)
    path.mkdir()
    assert work(folder) is WorkerExit.STORAGE
    path.rmdir()
    hidden.rename(path)
    assert not list(folder.path.glob("*.corrupt-*"))
    assert work(folder) is WorkerExit.DONE
    assert steps(folder) == [10, 20, 30, 40]


def test_a_run_without_its_history_looks_mixed(folder: RunFolder, monkeypatch: pytest.MonkeyPatch) -> None:
    """What it ran with before its provenance was damaged is unknown, not the same as now."""
    work(folder)
    folder.model.unlink()
    write_status(folder, dataclasses.replace(read_status(folder), state=RunState.INTERRUPTED))
    folder.provenance.write_bytes(folder.provenance.read_bytes()[:-9])
    monkeypatch.setenv("STANDIN_WORLD", "2")
    assert work(folder) is WorkerExit.DONE
    assert provenance.made_with(provenance.read_provenance(folder))["fingerprint.toy-car"] == "unknown, then 2"
    assert work(folder, "--fresh", "2") is WorkerExit.DONE
    assert provenance.made_with(provenance.read_provenance(folder))["fingerprint.toy-car"] == "2"


def test_a_resumed_run_is_told_how_it_multiplied(folder: RunFolder, capsys: pytest.CaptureFixture[str]) -> None:
    """By its first attempt; going on so is no change."""
    work(folder)
    folder.model.unlink()
    write_status(folder, dataclasses.replace(read_status(folder), state=RunState.INTERRUPTED))
    content = provenance.read_provenance(folder) or {}
    records.write_json(folder.provenance, content | {"products": {OTHERWISE: "numpy"}})
    assert work(folder) is WorkerExit.DONE
    assert "differs" not in capsys.readouterr().out
    assert provenance.made_with(provenance.read_provenance(folder))["products"] == "numpy"


def test_a_configuration_that_was_edited_is_refused(folder: RunFolder) -> None:
    """Its identity is no longer the folder's."""
    content = json.loads(folder.config.read_text())
    folder.config.write_text(json.dumps(content | {"seed": 7}))
    assert "it was edited" in refusal(folder)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"config_version": 99}, "configuration version 99"),
        ({"steps": -1}, "is not a configuration"),
        ({"unheard": 1}, "is not a configuration"),
    ],
)
def test_a_configuration_of_another_kind_is_refused(folder: RunFolder, change: dict[str, int], told: str) -> None:
    """Another version, impossible values and unknown keys are told apart from a trained run."""
    folder.config.write_text(json.dumps(json.loads(folder.config.read_text()) | change))
    assert told in refusal(folder)


def with_files(root: Path) -> tuple[RunConfig, list[Path]]:
    """A run, and a prior, a learner and demonstrations of the user's for it."""
    files = [root / name for name in ("mine.py", "taught.py", "shown.safetensors")]
    files[0].write_text("def closer(step):\n    return 0.0\n")
    files[1].write_text("class Taught:\n    pass\n")
    files[2].write_text("frames")
    return config(0), files


@pytest.mark.parametrize("at", range(3))
def test_a_file_that_is_not_there_now_stops_the_run(tmp_path: Path, at: int) -> None:
    """One that is gone, no Python any more, or a folder: said by name, no failure of the run, which goes on later."""
    planned, files = with_files(tmp_path)
    prior, learner, demos = map(str, files)
    update = [
        {"reward": RewardConfig(learner="prior", prior=f"{prior}:closer")},
        {"reward": RewardConfig(learner=f"{learner}:Taught"), "feedback": FeedbackConfig(segment=2), "horizon": 10},
        {"reward": RewardConfig(learner="airl"), "imitation": ImitationConfig(demos=demos, seed_steps=2)},
    ]  # fmt: skip
    planned = planned.model_copy(update=update[at]).canonical()
    folder, file = Layout(tmp_path).run(planned.identity), files[at]
    record_config(folder, config_content(planned))
    assert isinstance(load_config(folder), RunConfig)
    content = file.read_bytes()

    def stopped() -> str:
        assert work(folder) is WorkerExit.MISSING
        status = read_status(folder)
        assert status.state is RunState.INTERRUPTED
        assert status.error is not None
        assert status.error.kind is ErrorKind.MISSING
        assert "bring it back" in str(status.error)
        return str(status.error)

    file.write_bytes(b"def (")
    assert f"{file} has changed since this run was planned" in stopped()
    file.unlink()
    assert f"cannot read {file}" in stopped()
    file.mkdir()
    assert f"cannot read {file}" in stopped()
    file.rmdir()
    file.write_bytes(content)
    assert work(folder) is WorkerExit.DONE


def test_a_configuration_survives_its_file(folder: RunFolder) -> None:
    """What the worker reads is what was planned."""
    assert load_config(folder) == config(0).canonical()


class Slow(Trainer):
    """Would take half a minute to make its environment; told to stop by a signal meanwhile, if `signalled`."""

    def __init__(self, *, signalled: bool) -> None:
        self._signalled = signalled

    def fingerprint(self, config: RunConfig) -> dict[str, str]:
        if self._signalled:
            os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(30.0)
        raise AssertionError("it went on")


@pytest.mark.parametrize("signalled", [True, False], ids=["signal", "parent gone"])
def test_before_training_begins_a_stop_is_obeyed_at_once(folder: RunFolder, *, signalled: bool) -> None:
    """There is nothing to save yet: the run is interrupted, its lock free, in the middle of whatever was going on.

    Or never begun, where the parent was gone before.
    """
    parent = os.getppid() if signalled else 2**22 + 1
    told = [str(folder.path.parents[1]), folder.id, "--parent", str(parent)]
    assert main(told, Slow(signalled=signalled)) is WorkerExit.STOPPED
    status = read_status(folder)
    assert status.state is RunState.INTERRUPTED or (status.state is RunState.QUEUED and not signalled)
    assert status.error is None
    assert not is_locked(folder.lock)
    assert work(folder) is WorkerExit.DONE


def test_a_crash_leaves_the_run_to_whoever_comes_next(folder: RunFolder, monkeypatch: pytest.MonkeyPatch) -> None:
    """It has not failed for good: its parent may be gone before it can try again."""
    monkeypatch.setenv("STANDIN", '{"other": "crash-once"}')
    assert work(folder) is WorkerExit.CRASHED
    status = read_status(folder)
    assert (status.state, str(status.error)) == (RunState.INTERRUPTED, "RuntimeError: boom, but once")
    assert work(folder) is WorkerExit.DONE


def test_a_retry_forgets_the_error_of_the_attempt_before(folder: RunFolder) -> None:
    """A run that is done carries no error."""
    write_status(folder, Status(state=RunState.INTERRUPTED, attempt=4))
    assert work(folder) is WorkerExit.DONE
    status = read_status(folder)
    assert (status.attempt, status.error) == (5, None)


class CountConfig(ConfigSection):
    """A job of a kind of its own: it writes down how many steps it was asked for."""

    kind: ClassVar[str] = "count"

    profile: str = "paper"
    task: str = "toy-car"
    seed: int = 0
    steps: int = 3
    precision: str = "float32"
    threads: int = 1
    method: ClassVar[str] = "count"
    requires: ClassVar[tuple[str, ...]] = ()
    needs_opengl: ClassVar[bool] = False
    identity: ClassVar[str] = "00000000c0c0c0c0"
    cell: ClassVar[str] = "00000000c0c0c0c0"

    def canonical(self) -> CountConfig:
        return self

    def spec(self) -> Task:
        return TASKS[self.task]


def count(config: CountConfig, folder: Path, monitor: RunMonitor, results: Mapping[str, Path]) -> bool:
    with monitor.writing():
        (folder / "counted").write_text(str(config.steps))
    return True


def test_a_kind_of_job_of_ones_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A configuration, a function and a line in the table: it is recorded, checked, done and told like ours."""
    monkeypatch.setitem(JOBS, "count", JobKind(CountConfig, f"{__name__}:count"))
    folder = Layout(tmp_path).run(CountConfig().identity)
    record_config(folder, config_content(CountConfig(steps=7)))
    assert main([str(tmp_path), folder.id]) is WorkerExit.DONE
    assert (folder.path / "counted").read_text() == "7"
    assert read_status(folder).state is RunState.DONE
    assert provenance.read_provenance(folder)["fingerprint"]["gymnasium"]
