"""What commands say of a results folder that is another version's, or full."""

from __future__ import annotations

import json
import resource
from pathlib import Path

import pytest

from rrmctl.cli.request import Request
from rrmctl.store import records
from rrmctl.store.layout import Layout
from rrmctl.store.status import RunState, Status, write_status
from tests.rrmctl.cli.test_run import EXPERIMENTS, PLAN, call, settle
from tests.rrmctl.running.standin import prepare

ORACLE = (*PLAN, "--methods", "oracle", "--seeds", "1")


def held(root: Path) -> dict[str, bytes]:
    return {str(path.relative_to(root)): path.read_bytes() for path in root.rglob("*") if path.is_file()}


@pytest.mark.parametrize(
    "command",
    [
        ("status",),
        ("status", "stand-in"),
        ("resume",),
        ("run", *ORACLE),
        ("report", "iqm", "stand-in"),
        ("report", "html"),
    ],
    ids=" ".join,
)
def test_a_results_folder_of_another_version(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: tuple[str, ...]
) -> None:
    """One message with both versions, and nothing is touched."""
    prepare(tmp_path / "results", range(1))
    before = held(tmp_path)
    monkeypatch.setattr(records, "SCHEMA_VERSION", 2)
    monkeypatch.chdir(tmp_path)
    result = call(*command, "--results", tmp_path / "results")
    assert result.exit_code == 2, result.output
    assert "smoke.json is of schema version 1, this program reads 2" in result.stderr
    assert "use the rrmctl that wrote it, or another --results folder" in result.stderr
    assert held(tmp_path) == before


@pytest.mark.slow
def test_a_damaged_record_is_set_aside_and_written_again(tmp_path: Path) -> None:
    """By the command that asks for the sweep, which says so; the bytes are kept."""
    path = Layout(tmp_path).sweep("toy-car", "smoke")
    path.parent.mkdir(parents=True)
    path.write_text("{")
    settle(tmp_path, RunState.DONE, "1")
    result = call("run", *ORACLE, "--results", tmp_path)
    assert result.exit_code == 0, result.output
    assert "smoke.json.corrupt-1 and written anew" in result.stderr
    assert path.with_name("smoke.json.corrupt-1").read_text() == "{"
    assert json.loads(call("status", "--json", "--results", tmp_path).stdout)["done"] == 1


def test_no_space_while_a_sweep_is_recorded(tmp_path: Path) -> None:
    """There is nothing to resume yet: the same command again is what goes on."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, hard))
    try:
        result = call("run", *ORACLE, "--results", tmp_path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert result.exit_code == 75, result.output
    assert "config.json: File too large" in result.stderr
    assert "make space, then run the same command again" in " ".join(result.stderr.split())
    assert "resume" not in result.output
    assert json.loads(call("status", "--json", "--results", tmp_path).stdout)["runs"] == 0


@pytest.mark.slow
def test_a_run_without_its_configuration_is_healed_by_running_its_experiment_again(tmp_path: Path) -> None:
    """Gone between planning and start: `resume` says so and fails nothing for good; `run` writes it anew and trains."""
    sweep = ("run", *ORACLE, "--set", "steps=300", "--workers", "1", "--results", tmp_path)
    plan = Request("toy-car", EXPERIMENTS, "smoke", "1", methods=["oracle"], overrides=["steps=300"]).plan()
    folder = Layout(tmp_path).run(plan.jobs[0].id)
    write_status(folder, Status(state=RunState.DONE))
    assert call(*sweep).exit_code == 0  # recorded, and nothing to do
    for path in (folder.status, folder.config):
        path.unlink()
    result = call("resume", "--results", tmp_path)
    assert result.exit_code == 1
    assert "configurations are missing; this makes them, and the runs: rrmctl run toy-car" in result.stderr
    assert "failed" not in call("status", "--results", tmp_path).stdout
    result = call(*sweep)
    assert result.exit_code == 0, result.output
