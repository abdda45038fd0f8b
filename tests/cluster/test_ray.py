"""`--executor ray` on a real Ray of a head and two nodes that loses what can be lost; curves are as undisturbed."""

from __future__ import annotations

import os
import signal
from pathlib import Path
from subprocess import Popen

import pytest

from rrmctl.store.layout import Layout
from rrmctl.store.status import RunState, read_status, run_status
from tests.cluster.conftest import processes_of
from tests.cluster.ray import Ray
from tests.cluster.slurm import until
from tests.cluster.sweeps import same
from tests.rrmctl.cli.test_imitation import TOY
from tests.rrmctl.cli.test_run import PLAN, call, start

pytestmark = pytest.mark.cluster

#: Seconds a step are read from a file, as nodes have the environment that they were started in.
SLOW = """import time
from pathlib import Path


def slow(step):
    time.sleep(float((Path(__file__).parent / "pause").read_text()))
    return 0.0
"""


@pytest.fixture(scope="module")
def slowly(tmp_path_factory: pytest.TempPathFactory) -> tuple[list[str], Path]:
    """A sweep of two runs that are as slow as the file says, and its undisturbed twin's results."""
    folder = tmp_path_factory.mktemp("slowly")
    (folder / "prior.py").write_text(SLOW)
    (folder / "pause").write_text("0")
    settings = ["--methods", "rrm-slow", "--set", "steps=1500", "--set", "evaluation.every=100"]
    sweep = [*PLAN, "--prior", f"{folder / 'prior.py'}:slow", *settings]
    assert call("run", *sweep, "--seeds", "2", "--results", folder / "twin").exit_code == 0
    return ["run", *sweep, "--seeds", "2", "--executor", "ray"], folder


def ended(program: Popen[str]) -> tuple[int, str, str]:
    """Exit code, and what was said."""
    out, said = program.communicate(timeout=240)
    return program.returncode, out, said


def trains(root: Path, count: int = 2) -> bool:
    """So many runs are under way and have something to lose."""
    states = [run_status(Layout(root).run(run)) for run in Layout(root).run_ids()]
    return sum(status.state is RunState.RUNNING and status.rows > 0 for status in states) == count


def attempts(root: Path) -> list[int]:
    return [read_status(Layout(root).run(run)).attempt for run in Layout(root).run_ids()]


def parent(root: Path, run: str) -> int:
    """The process that started the run's worker."""
    worker = read_status(Layout(root).run(run)).pid
    return int(Path(f"/proc/{worker}/stat").read_text().rpartition(")")[2].split()[1])


def test_a_sweep_of_several_levels(ray: Ray, tmp_path: Path) -> None:
    """Expert, demonstrations, prior, runs, one after the other, to the end of the command; as on this machine."""
    mine, twin = tmp_path / "mine", tmp_path / "twin"
    code, out, said = ended(start("run", *TOY, "--executor", "ray", "--results", mine))
    assert code == 0, said
    assert "All done" in out
    assert said.count(": started") == said.count(": done (") == 5
    assert call("run", *TOY, "--results", twin).exit_code == 0
    same(mine, twin)


def test_kills(ray: Ray, tmp_path: Path, slowly: tuple[list[str], Path]) -> None:
    """Of a Ray worker and of a node, which the command survives; and of the command itself, which is given again."""
    sweep, folder = slowly
    (folder / "pause").write_text("0.08")
    first = start(*sweep, "--results", tmp_path)
    until(lambda: trains(tmp_path))
    os.kill(parent(tmp_path, Layout(tmp_path).run_ids()[0]), signal.SIGKILL)
    until(lambda: trains(tmp_path) and sorted(attempts(tmp_path)) == [1, 2])
    ray.kill_node("n1")
    until(lambda: trains(tmp_path, 1))
    ray.start_node("n1")
    until(lambda: trains(tmp_path) and sum(attempts(tmp_path)) == 4)
    os.killpg(first.pid, signal.SIGKILL)
    _, _, said = ended(first)
    assert said.count("will be tried again: ") >= 2, said
    until(lambda: not processes_of(tmp_path))
    logs = [Layout(tmp_path).run(run).log.read_text() for run in Layout(tmp_path).run_ids()]
    assert sum(log.count("--- interrupted ") for log in logs) == 4, logs
    (folder / "pause").write_text("0")
    code, _, said = ended(start(*sweep, "--results", tmp_path))
    assert code == 0, said
    same(tmp_path, folder / "twin")
    assert not list((tmp_path / "drivers").iterdir())


def test_stop(ray: Ray, tmp_path: Path, slowly: tuple[list[str], Path]) -> None:
    """Ctrl-C, and `rrmctl stop` from elsewhere: checkpoints, whatever has no node yet included; `resume` goes on."""
    sweep, folder = slowly
    (folder / "pause").write_text("0.08")
    for asked in ([*sweep, "--at-once", "1"], [*sweep, "--seeds", "3", "--address", ray.address]):
        program = start(*asked, "--results", tmp_path)
        until(lambda asked=asked: trains(tmp_path, 1 if "--at-once" in asked else 2))
        if "--at-once" in asked:
            program.send_signal(signal.SIGINT)
        else:
            stopped = call("stop", "toy-car", "--results", tmp_path)
            assert stopped.exit_code == 0, stopped.output
            assert f"this goes on: rrmctl resume toy-car --executor ray --address={ray.address}" in stopped.stdout
        code, out, said = ended(program)
        assert (code, "Not complete" in out) == (75, True), said
        assert not processes_of(tmp_path)
    (folder / "pause").write_text("0")
    assert call("resume", "--results", tmp_path).exit_code == 0
    assert call(*sweep[:-2], "--seeds", "3", "--results", tmp_path / "twin").exit_code == 0
    same(tmp_path, tmp_path / "twin")


def test_what_no_node_has_is_said(ray: Ray, tmp_path: Path) -> None:
    """Ray would wait for it without a word."""
    asked = [*PLAN, "--methods", "oracle", "--seeds", "1", "--set", "threads=3", "--memory", "2000"]
    program = start("run", *asked, "--executor", "ray", "--results", tmp_path)
    assert program.stderr is not None
    assert any("no node of the cluster has 3 cores, 2000.0 GiB now" in line for line in program.stderr)
    assert call("stop", "toy-car", "--results", tmp_path).exit_code == 0
    assert ended(program)[0] == 75


def test_a_cluster_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without an address, one of this machine alone, which ends with the command."""
    monkeypatch.delenv("RAY_ADDRESS", raising=False)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))  # Ray keeps a secret there
    sweep = [*PLAN, "--methods", "oracle", "--seeds", "1", "--results"]
    code, _, said = ended(start("run", *sweep, tmp_path / "mine", "--executor", "ray"))
    assert code == 0, said
    assert call("run", *sweep, tmp_path / "twin").exit_code == 0
    same(tmp_path / "mine", tmp_path / "twin")
