"""Tasks that Slurm, its administrators and their user disturb: the same curves as undisturbed."""

from __future__ import annotations

from pathlib import Path

import pytest

from rrmctl.store.layout import Layout
from rrmctl.store.status import RunState, read_status, run_status
from tests.cluster.slurm import Slurm, until
from tests.cluster.sweeps import same, told
from tests.rrmctl.cli.test_run import PLAN, call

pytestmark = pytest.mark.cluster

SLOW = """import os, time


def slow(step):
    if os.path.exists(os.environ.get('SLOW_WHILE', '')):
        time.sleep(0.05)
    return 0.0
"""


@pytest.fixture(scope="module")
def slowly(tmp_path_factory: pytest.TempPathFactory) -> tuple[list[str], Path]:
    """A sweep whose runs are slow while the file SLOW_WHILE is there; and its undisturbed twin's results."""
    folder = tmp_path_factory.mktemp("slowly")
    (folder / "prior.py").write_text(SLOW)
    settings = ["--methods", "rrm-slow", "--set", "steps=1500", "--set", "evaluation.every=100"]
    sweep = [*PLAN, "--prior", f"{folder / 'prior.py'}:slow", *settings]
    assert call("run", *sweep, "--seeds", "3", "--results", folder / "twin").exit_code == 0
    return sweep, folder / "twin"


@pytest.fixture
def hold(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Runs are slow until this file is removed: however busy the machine, none ends before it was disturbed."""
    held = tmp_path / "hold"
    held.touch()
    monkeypatch.setenv("SLOW_WHILE", str(held))
    return held


def log(root: Path, task: str) -> str:
    return (root / "slurm" / f"{task}.log").read_text()


def trains(root: Path, count: int) -> bool:
    """So many runs are under way and have something to lose."""
    states = [run_status(Layout(root).run(run)) for run in Layout(root).run_ids()]
    return sum(status.state is RunState.RUNNING and status.rows > 0 for status in states) == count


def at_once(cluster: Slurm, *tasks: str) -> None:
    """What was queued again is held for a while; a test does not wait for that."""
    for task in tasks:
        until(lambda task=task: f"{task} PENDING" in " ".join(cluster.queue()))
        cluster.ask("scontrol", "update", f"jobid={task}", "StartTime=now")


def test_preempted_requeued_and_cancelled(
    cluster: Slurm, tmp_path: Path, slowly: tuple[list[str], Path], hold: Path
) -> None:
    """What Slurm takes the node of goes on by itself; what its user cancels stays away until it is submitted again."""
    sweep, twin = slowly
    asked = ["run", *sweep, "--seeds", "3", "--executor", "slurm", "--results", tmp_path]
    job = call(*asked).stdout.split("as job ")[1].split(",")[0]
    until(lambda: trains(tmp_path, 3))
    nodes = dict(line.split()[::2] for line in cluster.queue())
    cluster.ask("sbatch", "-p", "high", "-w", nodes[f"{job}_0"], "-o", "/dev/null", "--wrap", "sleep 1")
    cluster.ask("scontrol", "requeue", f"{job}_1")
    cluster.ask("scancel", f"{job}_2")
    at_once(cluster, f"{job}_0", f"{job}_1")
    hold.unlink()
    assert "queued again" in log(tmp_path, f"{job}_0")
    assert "checkpoints are written" in log(tmp_path, f"{job}_2")
    assert "queued again" not in log(tmp_path, f"{job}_2")
    until(lambda: not cluster.queue())
    state = told(tmp_path)
    assert (state["done"], state["interrupted"]) == (2, 1)
    resumed = call("resume", "toy-car", "--executor", "slurm", "--results", tmp_path)
    assert (resumed.exit_code, resumed.stdout.count("1 run submitted")) == (75, 1), resumed.output
    until(lambda: not cluster.queue())
    assert call("resume", "--executor", "slurm", "--results", tmp_path).exit_code == 0
    same(tmp_path, twin)


def test_a_node_that_is_lost_while_its_job_lives_on(
    cluster: Slurm, tmp_path: Path, slowly: tuple[list[str], Path], hold: Path
) -> None:
    """The job runs on two nodes then; the lease lets one of them train, and the other waits for it."""
    sweep, twin = slowly
    asked = ["run", *sweep, "--seeds", "1", "--executor", "slurm", "--results", tmp_path]
    job = call(*asked).stdout.split("as job ")[1].split(",")[0]
    until(lambda: trains(tmp_path, 1))
    (node,) = (line.split()[2] for line in cluster.queue())
    cluster.kill_node(node)
    try:
        at_once(cluster, f"{job}_0")
        until(lambda: "requeued 1 times" in log(tmp_path, f"{job}_0"))
        hold.unlink()
        until(lambda: not cluster.queue())
    finally:
        cluster.start_node(node)
    (run,) = Layout(tmp_path).run_ids()
    assert run_status(Layout(tmp_path).run(run)).state is RunState.DONE
    assert read_status(Layout(tmp_path).run(run)).attempt == 1
    same(tmp_path, twin)


def test_stop(cluster: Slurm, tmp_path: Path, slowly: tuple[list[str], Path], hold: Path) -> None:
    """What is queued leaves the queue, what runs checkpoints and leaves, and both stay away."""
    sweep, twin = slowly
    call("run", *sweep, "--seeds", "2", "--executor", "slurm", "--at-once", "1", "--results", tmp_path)
    until(lambda: trains(tmp_path, 1))
    state = told(tmp_path)["slurm"]
    assert [len(runs) for kind in ("queued", "running") for runs in state[kind].values()] == [1, 1]
    stopped = call("stop", "toy-car", "--results", tmp_path)
    assert stopped.exit_code == 0, stopped.output
    assert "this goes on: rrmctl resume toy-car --executor slurm" in stopped.stdout
    assert cluster.queue() == []
    assert told(tmp_path)["interrupted"] == 1
    hold.unlink()
    assert call("resume", "--results", tmp_path).exit_code == 0
    same(tmp_path, twin)
    assert "Nothing of toy-car" in call("stop", "toy-car", "--results", tmp_path).stdout
