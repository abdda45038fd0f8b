"""A sweep makes what its runs need: an expert, demonstrations, a prior."""

from __future__ import annotations

import json
import os
import shutil
import signal
import time
from pathlib import Path

import pytest

from rrmctl.store import load, planned
from rrmctl.store.layout import Layout
from rrmctl.store.status import RunState, run_status
from rrmctl.store.sweeps import read_sweeps
from tests.rrmctl.cli.test_run import EXPERIMENTS, call, numbers, start

TOY = [
    "toy-car", "--experiments", str(EXPERIMENTS), "--profile", "smoke", "--prior", "imitation",
    "--methods", "rrm-imitation", "--seeds", "2",
]  # fmt: skip


#: The same on the task with a camera, as an experiment of one's own.
SEEN = """
title = "Imitation by pictures"
reproduces = ["r"]
rule = "r"
grid = { tasks = ["toy-car-image"], methods = ["rrm-imitation"] }
"""


@pytest.mark.slow
@pytest.mark.parametrize("manifest", [None, SEEN], ids=["states", "pictures"])
@pytest.mark.long
def test_from_nothing_killed_and_resumed(tmp_path: Path, manifest: str | None) -> None:
    """SIGKILL at every stage of the chain; it ends as undisturbed, bit for bit, each need met once for two seeds."""
    asked = TOY
    if manifest is not None:
        (tmp_path / "toy-car.toml").write_text(manifest)
        asked = ["toy-car", "--experiments", str(tmp_path), "--profile", "smoke", "--seeds", "2"]
    quiet, loud = tmp_path / "quiet", tmp_path / "loud"
    assert call("run", *asked, "--results", quiet).exit_code == 0
    for wait in (5.0, 8.0, 8.0):
        program = start("run", *asked, "--workers", "1", "--results", loud)
        time.sleep(wait)
        (sweep,) = read_sweeps(Layout(loud))
        for job in sweep.everything:
            status = run_status(Layout(loud).run(job.id))
            if status.state is RunState.RUNNING and status.pid is not None:
                os.kill(status.pid, signal.SIGKILL)
        os.killpg(program.pid, signal.SIGKILL)
        program.communicate()
    result = call("resume", "--results", loud)
    assert result.exit_code == 0, result.output
    assert [job.method for job in sweep.needed] == ["expert", "demos", "airl"]
    assert len(Layout(loud).run_ids()) == 5
    assert numbers(loud) == numbers(quiet)
    for run in Layout(loud).run_ids():
        for name in ("model.safetensors", "demos.safetensors", "demos.safetensors.frames"):
            files = [root / "runs" / run / name for root in (quiet, loud)]
            assert files[0].exists() == files[1].exists()
            assert not files[0].exists() or files[0].read_bytes() == files[1].read_bytes()
    assert set(planned(loud, "toy-car")["method"]) == {"rrm-imitation"}
    assert set(load(loud, "toy-car")["method"]) == {"rrm-imitation"}
    report = call("report", "iqm", "toy-car", "--format", "csv", "--results", loud).stdout
    assert "rrm-imitation" in report
    assert "airl" not in report
    again = call("run", *asked, "--results", loud)
    assert again.exit_code == 0
    assert "5 done already" in again.stderr


@pytest.mark.slow
@pytest.mark.sim
@pytest.mark.long
def test_the_chain_on_meta_world(tmp_path: Path) -> None:
    """The experiment's own oracle is the expert; both methods on the prior share it."""
    sweep = ["main-results", "--experiments", str(EXPERIMENTS), "--profile", "smoke", "--tasks", "button-press"]
    result = call("run", *sweep, "--methods", "oracle,rrm-imitation", "--seeds", "1", "--results", tmp_path)
    assert result.exit_code == 0, result.output
    assert "2 runs and 2 that they need" in result.stderr
    told = json.loads(call("status", "main-results", "--json", "--results", tmp_path).stdout)
    assert (told["runs"], told["done"]) == (4, 4)
    noisy = ["noisy-teacher", "--experiments", str(EXPERIMENTS), "--profile", "smoke", "--methods", "rrm-imitation"]
    plan = json.loads(call("plan", *noisy, "--seeds", "1", "--json", "--results", tmp_path).stdout)
    assert [(job["method"], job["state"]) for job in plan["needed"]] == [
        ("expert", "done"), ("demos", "done"), ("airl", "done")
    ]  # fmt: skip


@pytest.mark.slow
def test_what_needs_a_failed_run_is_blocked(tmp_path: Path) -> None:
    """An expert too weak: its demonstrations fail, nothing after them runs, and everybody is told why."""
    strict = [*TOY, "--set", "imitation.expert_success=1.0", "--results", str(tmp_path)]
    result = call("run", *strict)
    assert result.exit_code == 1
    assert result.stderr.count("not run: run") == 3
    assert result.stderr.count("the expert succeeds in") == 4
    told = json.loads(call("status", "--json", "--results", tmp_path).stdout)
    assert (told["done"], told["failed"], told["blocked"]) == (1, 1, 3)
    assert "which it needs, failed: DemosError" in call("status", "--failed", "--results", tmp_path).stdout
    assert set(planned(tmp_path, "toy-car")["state"]) == {"blocked"}
    for command in (["run", *strict], ["resume", "--results", str(tmp_path)]):
        again = call(*command)
        assert again.exit_code == 1
        assert "started" not in again.stderr
    retried = call("resume", "--retry-failed", "--results", tmp_path)
    assert retried.exit_code == 1
    assert "demos seed 0: started, attempt 2" in retried.stderr


@pytest.mark.slow
@pytest.mark.long
def test_an_expert_whose_networks_were_changed_is_made_again(tmp_path: Path) -> None:
    """What needs it refuses it and says how; that way leads to the end."""
    expert = ["toy-car", "--experiments", str(EXPERIMENTS), "--profile", "smoke", "--methods", "oracle", "--seeds", "1"]
    assert call("run", *expert, "--results", tmp_path).exit_code == 0
    (run,) = (run for run in planned(tmp_path, "toy-car")["run"])
    model = Layout(tmp_path).run(run).model
    data = bytearray(model.read_bytes())
    data[-30] ^= 1
    model.write_bytes(data)
    sweep = [*TOY, "--results", str(tmp_path)]
    result = call("run", *sweep)
    assert result.exit_code == 1, result.output
    said = " ".join(result.stderr.split())
    assert f"{model}, the policy's networks, is damaged (not a saved state: its content does not match" in said
    assert f"bring it back, or remove {model.parent} and run the experiment again with --retry-failed" in said
    shutil.rmtree(model.parent)
    result = call("run", *sweep, "--retry-failed")
    assert result.exit_code == 0, result.output


@pytest.mark.slow
def test_demonstrations_by_hand(tmp_path: Path) -> None:
    """Collected from a finished run, shown, and handed to a run of one's own."""
    root = tmp_path / "results"
    oracle = ["toy-car", "--experiments", str(EXPERIMENTS), "--profile", "smoke", "--methods", "oracle", "--seeds", "1"]
    assert call("run", *oracle, "--results", root).exit_code == 0
    (run,) = Layout(root).run_ids()
    file = tmp_path / "mine.safetensors"
    collect = ["demos", "collect", file, "--run", run[:6], "--episodes", "3", "--results", root]
    refused = call(*collect, "--least-success", "1.0")
    assert refused.exit_code == 2
    assert "the expert succeeds in" in refused.stderr
    assert not file.exists()
    result = call(*collect, "--least-success", "0")
    assert result.exit_code == 0, result.output
    told = json.loads(call("demos", "show", file).stdout)
    assert (told["expert"], told["source"], told["episodes"]) == (run, "expert", 3)
    result = call("run", *TOY[:-1], "1", "--set", f"imitation.demos={file}", "--results", root)
    assert result.exit_code == 0, result.output
    assert "1 run and 1 that they need" in result.stderr


@pytest.mark.sim
def test_scripted_demonstrations_say_so(tmp_path: Path) -> None:
    """On request, and in the provenance."""
    result = call("demos", "collect", tmp_path / "s.safetensors", "--scripted", "button-press", "--episodes", "1")
    assert result.exit_code == 0, result.output
    assert json.loads(call("demos", "show", tmp_path / "s.safetensors").stdout)["source"] == "scripted"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["collect", "x.safetensors"], "whose demonstrations?"),
        (["collect", "x.safetensors", "--scripted", "toy-car"], "has no scripted policy"),
        (["collect", "x.safetensors", "--run", "ab", "--results", "nowhere"], "there is no results folder"),
        (["show", "nowhere.safetensors"], "cannot be read as demonstrations"),
    ],
)
def test_mistakes(arguments: list[str], message: str) -> None:
    """Exit code 2 and one message."""
    result = call("demos", *arguments)
    assert result.exit_code == 2
    assert message in result.stderr
    assert "Traceback" not in result.stderr
