"""`run --until-decided`: which seeds it runs, what it says, and that it comes to the same decisions again."""

from __future__ import annotations

import json
import signal
import time
from pathlib import Path

import numpy as np
import pytest
from typer.testing import Result

from rrmctl.cli.request import Request
from rrmctl.running.config_file import config_content
from rrmctl.store import planned
from rrmctl.store.curve import CurveWriter
from rrmctl.store.layout import Layout
from rrmctl.store.provenance import record_config
from rrmctl.store.records import write_json
from rrmctl.store.schema import SCHEMA_VERSION
from rrmctl.store.status import RunState, Status, write_status
from rrmctl.store.trials import Pairing, Trial, begin_trial, read_trial
from tests.rrmctl.cli.test_run import ERROR, EXPERIMENTS, PLAN, call, start
from tests.rrmctl.reports.frames import Sweep
from tests.rrmctl.running.standin import row

METHODS = ["--methods", "oracle,pebble,rrm-sparse"]
#: What a method scores at every evaluation of a run, by its seed's noise in [-0.1, 0.1].
LEVELS = {"oracle": 0.8, "pebble": 0.3, "rrm-sparse": 0.32}
TWO_TEACHERS = """
title = "Two teachers"
reproduces = ["nothing"]
rule = "none"
seeds = 5

[grid]
tasks = ["toy-car"]
methods = ["oracle", "pebble"]
teachers = ["oracle", "mistaken-10"]
"""


def train(root: Path, manifest: str = "toy-car", seeds: int = 10, failed: tuple[str, int] | None = None) -> None:
    """Pretend that all runs are done, with curves about their methods' levels."""
    request = Request(manifest, EXPERIMENTS, profile="smoke", seeds=str(seeds))
    plan = request.plan()
    for job in plan.jobs:
        folder, steps = Layout(root).run(job.id), job.steps
        content = config_content(plan.configs[job.id])
        record_config(folder, content)
        noise = np.random.default_rng([job.seed, *job.method.encode()]).uniform(-0.1, 0.1)
        curve = CurveWriter(folder, content | {"run": job.id})
        for step in (steps // 2, steps):
            curve.add(row(step, job.seed, success=LEVELS[job.method] + noise).columns())
        state = RunState.FAILED if failed == (job.method, job.seed) else RunState.DONE
        error = ERROR if state is RunState.FAILED else None
        write_status(folder, Status(state=state, attempt=1, step=steps, steps=steps, rows=2, wall_s=6.0, error=error))


def decide(root: Path, *options: str) -> Result:
    return call("run", *PLAN, *METHODS, "--until-decided", "--results", root, *options)


def seeds_of(root: Path, experiment: str = "toy-car") -> dict[str, int]:
    return planned(root, experiment).groupby("method")["seed"].nunique().to_dict()


@pytest.mark.slow
def test_what_is_decided_runs_no_further_seeds(tmp_path: Path) -> None:
    """The oracle is apart after ten seeds and is let go; two methods that are alike go on to the last look."""
    train(tmp_path, seeds=20)
    result = decide(tmp_path, "--max-seeds", "20", "--against", "pebble")
    assert result.exit_code == 0, result.output
    assert seeds_of(tmp_path) == {"oracle": 10, "pebble": 20, "rrm-sparse": 20}
    last = result.stdout.split("Look 4 of 4, after 20 seeds:")[1]
    assert "oracle against pebble: better, decided by the first 10 seeds" in last
    assert "rrm-sparse against pebble: not separated by 20 seeds" in last
    assert "rrm-sparse against pebble: open" in result.stdout.split("Look 2 of 4")[1].split("Look 3")[0]


@pytest.mark.slow
def test_another_variants_runs_are_no_matter(tmp_path: Path) -> None:
    """Runs of another profile that do not belong together stop nothing; those of the test's own are refused."""
    train(tmp_path)
    Sweep(experiment="toy-car", tasks=("toy-car",), versions={("toy-car", "pebble", 0): 1}).write(tmp_path)
    result = decide(tmp_path, "--max-seeds", "10")
    assert result.exit_code == 0, result.output
    own = planned(tmp_path, "toy-car").query("profile == 'smoke'")["run"]
    for run, torch in zip(own, ("2.4.0", "2.6.0"), strict=False):
        made = {"schema_version": SCHEMA_VERSION, "versions": {"torch": torch}, "resumed": []}
        write_json(Layout(tmp_path).run(run).provenance, made)
    result = decide(tmp_path, "--max-seeds", "10")
    assert result.exit_code == 2
    assert "toy-car, profile smoke: its runs do not belong in one report" in result.stderr


def test_it_stops_when_everything_is_decided(tmp_path: Path) -> None:
    """Against the oracle both are clearly worse: no second group is run, though ten seeds were allowed."""
    train(tmp_path)
    result = decide(tmp_path, "--max-seeds", "10")
    assert result.exit_code == 0, result.output
    assert "pebble against oracle: worse, decided by the first 5 seeds" in result.stdout
    assert "Look 2" not in result.stdout
    assert seeds_of(tmp_path) == {"oracle": 5, "pebble": 5, "rrm-sparse": 5}


@pytest.mark.slow
def test_called_again_it_says_the_same_and_keeps_its_rules(tmp_path: Path) -> None:
    """Word for word; the report has the same decisions by the same rules; other rules are refused, both named."""
    train(tmp_path)
    first, again = (decide(tmp_path, "--max-seeds", "10", "--against", "pebble").stdout for _ in range(2))
    assert first == again
    told = json.loads(call("report", "power", "toy-car", "--results", tmp_path, "--format", "json").stdout)
    (report,) = told["reports"]
    assert report["test"] == {"group": 5, "looks": 2, "alpha": 0.05, "comparisons": 2, "fixed_in_advance": True}
    decisions = {(each["method"], each["decision"], each["seeds"]) for each in report["rows"]}
    assert decisions == {("oracle", "better", 5), ("rrm-sparse", "not separated", 10)}
    for options in (["--max-seeds", "15"], ["--max-seeds", "10", "--group", "2"], ["--max-seeds", "10"]):
        result = decide(tmp_path, *options)
        assert result.exit_code == 2
        assert "a test with other rules was begun here: groups of 5 seeds, at most 10" in result.stderr


@pytest.mark.slow
def test_a_failed_run_decides_nothing(tmp_path: Path) -> None:
    """The look waits for the run; the exit code is that of a failure."""
    train(tmp_path, failed=("pebble", 6))
    result = decide(tmp_path, "--max-seeds", "10", "--against", "rrm-sparse")
    assert result.exit_code == 1
    assert "Look 1 of 2" in result.stdout
    assert "Look 2" not in result.stdout
    assert "Nothing more is decided before these runs are done" in result.stdout


@pytest.mark.slow
def test_every_panel_is_decided(tmp_path: Path) -> None:
    """Two teachers are two comparisons that share one level, and the oracle's runs are of both."""
    manifest = tmp_path / "teachers.toml"
    manifest.write_text(TWO_TEACHERS)
    train(tmp_path / "r", str(manifest))
    result = call(
        "run", manifest, "--profile", "smoke", "--until-decided", "--max-seeds", "10", "--results", tmp_path / "r"
    )
    assert result.exit_code == 0, result.output
    for teacher in ("oracle", "mistaken-10"):
        assert f"({teacher}, 8@100/24), pebble against oracle: worse, decided by the first 5 seeds" in result.stdout
    assert seeds_of(tmp_path / "r", "teachers") == {"oracle": 5, "pebble": 5}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--until-decided"], "takes --max-seeds N"),
        (["--until-decided", "--max-seeds", "10", "--seeds", "3"], "neither --seeds nor --force"),
        (["--until-decided", "--max-seeds", "10", "--force"], "neither --seeds nor --force"),
        (["--max-seeds", "10"], "belong to --until-decided"),
        (["--against", "pebble"], "belong to --until-decided"),
        (["--until-decided", "--max-seeds", "12"], "no whole number of groups of 5"),
        (["--until-decided", "--max-seeds", "10", "--against", "surf"], "there is no surf"),
        (["--until-decided", "--max-seeds", "10", "--methods", "oracle"], "oracle is the only method"),
    ],
)
def test_options_that_do_not_go_together(tmp_path: Path, options: list[str], message: str) -> None:
    """Exit code 2 and one message, before anything is run."""
    result = call("run", *PLAN, "--results", tmp_path, *options)
    assert result.exit_code == 2
    assert message in result.stderr
    assert not list(tmp_path.glob("runs/*"))


def test_the_rules_are_kept_as_they_were(tmp_path: Path) -> None:
    """Written once, read back equal; a damaged file is named."""
    layout, pair = Layout(tmp_path), Pairing("toy-car", "oracle", "8@100/24", "pebble", "oracle")
    trial = Trial(group=5, looks=4, alpha=0.05, pairs=(pair,))
    assert read_trial(layout, "toy-car", "smoke") is None
    begin_trial(layout, "toy-car", "smoke", trial)
    assert read_trial(layout, "toy-car", "smoke") == trial
    layout.trial("toy-car", "smoke").write_text('{"group": 5, "looks": 4, "schema_version": 1, "pairs": [{}]}')
    result = call("run", *PLAN, "--until-decided", "--max-seeds", "20", "--results", tmp_path)
    assert result.exit_code == 2
    assert "smoke.json is damaged" in result.stderr


@pytest.mark.slow
@pytest.mark.long
def test_real_runs_interrupted_come_to_the_same_decisions(tmp_path: Path) -> None:
    """Trained on the toy car, stopped by Ctrl-C between two looks and called again: word for word the same."""
    sweep = ["run", *PLAN, "--methods", "oracle,pebble", "--set", "steps=450", "--workers", "2"]
    sweep += ["--until-decided", "--max-seeds", "4", "--group", "2", "--results"]
    quiet = call(*sweep, tmp_path / "quiet")
    assert quiet.exit_code == 0, quiet.output
    program = start(*sweep, tmp_path / "loud")
    while len(list((tmp_path / "loud").glob("runs/*/status.json"))) < 3:
        time.sleep(0.1)
        assert program.poll() is None
    program.send_signal(signal.SIGINT)
    out, _ = program.communicate(timeout=120)
    assert program.returncode == 75
    assert "the same command goes on" in out
    again = call(*sweep, tmp_path / "loud")
    assert again.exit_code == 0, again.output
    assert again.stdout.replace("loud", "quiet") == quiet.stdout
    assert "Look 2 of 2, after 4 seeds:" in again.stdout
