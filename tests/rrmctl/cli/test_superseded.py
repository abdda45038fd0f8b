"""Settings or files that change between two `run`s: what was made before gives way, is left out, and can be removed."""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import Result

from rrmctl.cli.request import Request
from rrmctl.running.config_file import config_content
from rrmctl.store import load, planned
from rrmctl.store.curve import CurveWriter
from rrmctl.store.files import try_lock
from rrmctl.store.layout import Layout
from rrmctl.store.provenance import record_config
from rrmctl.store.status import RunState, Status, write_status
from rrmctl.store.sweeps import SweepRecord, read_sweeps, record_sweep
from tests.rrmctl.cli.test_run import call
from tests.rrmctl.running.standin import row

MANIFEST = """
title = "Mine"
reproduces = ["nothing"]
rule = "none"
seeds = 1

[grid]
tasks = ["toy-car"]
methods = [{methods}]

[method.rrm-p]
prior = "mine.py:p"
"""


@dataclasses.dataclass
class Workshop:
    """A user's folder: a manifest, a prior, and results."""

    folder: Path

    def write(self, *, methods: str = '"rrm-p"', prior: str = "step.reward", more: str = "") -> None:
        (self.folder / "mine.py").write_text(f"def p(step):\n    return {prior}\n")
        (self.folder / "mine.toml").write_text(MANIFEST.format(methods=methods) + more)

    @property
    def results(self) -> Path:
        return self.folder / "results"

    @property
    def layout(self) -> Layout:
        return Layout(self.results)

    def run(self, seeds: str, *options: str, state: RunState = RunState.DONE) -> Result:
        """`rrmctl run` where every run has been trained already, as far as `state` says."""
        overrides = [each for each in options if "=" in each]
        plan = Request(str(self.folder / "mine.toml"), profile="smoke", seeds=seeds, overrides=overrides).plan()
        for job in plan.everything:
            folder, steps = self.layout.run(job.id), job.steps
            content = config_content(plan.configs[job.id])
            record_config(folder, content)
            if not folder.curve.exists() and state is RunState.DONE:
                CurveWriter(folder, content | {"run": job.id}).add(
                    *(row(step, success=1.0).columns() for step in (steps // 2, steps))
                )
            write_status(folder, Status(state=state, attempt=1, step=steps, steps=steps, rows=2, wall_s=6.0))
        asked = [word for each in overrides for word in ("--set", each)]
        return self.call("run", "mine.toml", "--profile", "smoke", "--seeds", seeds, *asked)

    def call(self, *words: str) -> Result:
        before = Path.cwd()
        os.chdir(self.folder)
        try:
            return call(*words, "--results", self.results)
        finally:
            os.chdir(before)


@pytest.fixture
def workshop(tmp_path: Path) -> Workshop:
    found = Workshop(tmp_path)
    found.write()
    return found


def edit_the_prior(workshop: Workshop) -> None:
    workshop.write(prior="-step.reward")


def edit_the_manifest(workshop: Workshop) -> None:
    workshop.write(more="\n[defaults.agent]\ntau = 0.3\n")


@pytest.mark.slow
@pytest.mark.parametrize("change", [edit_the_prior, edit_the_manifest])
def test_what_was_made_of_other_files_is_left_out_and_said_so(
    workshop: Workshop, change: Callable[[Workshop], None]
) -> None:
    """Tables, figures and frames are of the runs asked for last; the others stay on disk until they are removed."""
    assert workshop.run("2").exit_code == 0
    old = set(planned(workshop.results)["run"])
    change(workshop)
    done = workshop.run("3")
    assert done.exit_code == 0, done.output
    assert "note: 2 runs of other settings, files or versions gave way" in done.stderr
    assert "note" not in workshop.run("3").stderr
    for words in (("report", "iqm", "mine"), ("report", "all"), ("report", "power", "mine"), ("plot", "mine")):
        told = workshop.call(*words, "--replicates", "100")
        if words[1] != "power":  # one method alone has no comparison
            assert told.exit_code == 0, told.output
        assert "configurations" not in told.output
    told = workshop.call("report", "iqm", "mine", "--format", "json", "--replicates", "100")
    (report,) = json.loads(told.stdout)["reports"]
    assert report["problems"] == [
        "2 runs are left out: of other settings, files or versions than what was asked for since."
    ]
    assert (report["planned_runs"], report["contained_runs"]) == (3, 3)
    assert not old & set(load(workshop.results, "mine")["run"])
    assert json.loads(workshop.call("status", "--json").stdout)["runs"] == 3
    assert "superseded" in workshop.call("show", old.pop()).stdout


@pytest.mark.slow
def test_what_is_asked_for_again_takes_its_place_again(workshop: Workshop) -> None:
    """The old file brought back names the old runs, which are done."""
    workshop.run("2")
    first = list(planned(workshop.results)["run"])
    edit_the_prior(workshop)
    workshop.run("2")
    assert not set(first) & set(planned(workshop.results)["run"])
    workshop.write()
    workshop.run("2")
    assert list(planned(workshop.results)["run"]) == first


@pytest.mark.slow
def test_seeds_of_an_earlier_state_alone_are_told_what_to_do(workshop: Workshop) -> None:
    """Where fewer seeds were asked for anew the rest do not meet them, and asking for all of them helps."""
    workshop.run("3")
    edit_the_prior(workshop)
    workshop.run("2")
    told = workshop.call("report", "iqm", "mine")
    assert told.exit_code == 2
    assert "--seeds 0,1,2" in told.stderr
    workshop.run("0,1,2")
    assert workshop.call("report", "iqm", "mine", "--replicates", "100").exit_code == 0


@pytest.mark.slow
def test_a_changed_override_is_a_variant_of_its_own(workshop: Workshop) -> None:
    """Nothing gives way: both have tables."""
    workshop.run("2")
    workshop.run("2", "agent.batch=32")
    told = workshop.call("report", "iqm", "mine", "--format", "json", "--replicates", "100")
    assert [report["problems"] for report in json.loads(told.stdout)["reports"]] == [[], []]
    assert "Every run is asked for" in workshop.call("clean").stdout


@pytest.mark.slow
def test_changed_demonstrations_and_what_they_were_needed_for_give_way(workshop: Workshop) -> None:
    """The runs on them and the prior in between: neither is reported, gone on with or kept by `clean`."""
    workshop.write(methods='"rrm-p", "rrm-imitation"', more='\n[defaults.imitation]\ndemos = "demos.safetensors"\n')
    plans = []
    for content in (b"these", b"those"):
        (workshop.folder / "demos.safetensors").write_bytes(content)
        assert workshop.run("2").exit_code == 0
        (sweep,) = read_sweeps(workshop.layout)
        plans.append({job.id for job in sweep.everything})
    assert [len(plan) for plan in plans] == [5, 5]  # two of each method, and the prior that is trained first
    assert len(plans[0] & plans[1]) == 2
    assert workshop.call("report", "iqm", "mine", "--replicates", "100").exit_code == 0
    workshop.call("clean", "--yes")
    assert set(workshop.layout.run_ids()) == plans[1]


@pytest.mark.slow
def test_runs_that_gave_way_are_not_gone_on_with(workshop: Workshop) -> None:
    """A file that changed half way: `resume` is about the new runs alone."""
    workshop.run("2", state=RunState.FAILED)
    edit_the_prior(workshop)
    workshop.run("2")
    done = workshop.call("resume")
    assert (done.exit_code, "0 of 2 runs to go" in done.stderr) == (0, True), done.output


@pytest.mark.slow
def test_clean_lists_and_then_removes(workshop: Workshop) -> None:
    """Without --yes nothing is touched; with it all goes that no record names, but for a run that somebody owns."""
    workshop.run("2")
    old = workshop.layout.run_ids()
    edit_the_prior(workshop)
    workshop.run("2")
    kept = set(workshop.layout.run_ids()) - set(old)
    listed = workshop.call("clean")
    assert listed.exit_code == 0
    assert all(f"{run} " in listed.stdout for run in old)
    assert "smoke toy-car rrm-p seed 1: done" in listed.stdout
    assert "2 runs, 0.0 MB. Nothing was removed; --yes removes them." in listed.stdout
    assert set(workshop.layout.run_ids()) == {*old, *kept}
    lock = try_lock(workshop.layout.run(old[0]).lock)
    assert lock is not None
    told = workshop.call("clean", "--yes").stdout
    assert f"{old[0]} is in use and stays" in told
    assert set(workshop.layout.run_ids()) == {old[0], *kept}
    os.close(lock)
    assert "1 run, 0.0 MB: removed." in workshop.call("clean", "--yes").stdout
    assert {path.name for path in (workshop.results / "runs").iterdir()} == kept
    (sweep,) = read_sweeps(workshop.layout)
    assert sweep.superseded == ()
    assert "Every run is asked for" in workshop.call("clean").stdout


@pytest.mark.slow
def test_clean_trusts_no_damaged_record(workshop: Workshop) -> None:
    """It may name any run: nothing is removed."""
    workshop.run("2")
    (path,) = workshop.layout.sweep_files("mine")
    path.write_text("{")
    told = workshop.call("clean", "--yes")
    assert told.exit_code == 2
    assert "mine/smoke.json cannot be read" in told.stderr
    assert len(workshop.layout.run_ids()) == 2


def test_a_removal_that_was_cut_short_is_completed(workshop: Workshop) -> None:
    """What is left of a folder that was being removed is nobody's run, and goes the next time."""
    workshop.run("1")
    half = workshop.results / "runs" / ".0123456789abcdef.removed"
    (half / "checkpoint").mkdir(parents=True)
    assert workshop.layout.run_ids() == list(planned(workshop.results)["run"])
    workshop.call("clean", "--yes")
    assert not half.exists()


def test_a_record_tells_apart_what_it_reads(workshop: Workshop) -> None:
    """The file of two states says which run came later, also one that was written before anybody looked at that."""
    plan = Request(str(workshop.folder / "mine.toml"), profile="smoke", seeds="2").plan()
    jobs = plan.jobs
    later = tuple(dataclasses.replace(job, id=job.id[::-1], cell="new") for job in jobs)
    layout = workshop.layout
    for asked in (jobs, later):
        union = record_sweep(layout, SweepRecord(experiment="mine", variant="smoke", profile="smoke", jobs=asked))
    assert (union.jobs, union.superseded) == (later, jobs)
    assert read_sweeps(layout) == [union]
    path = layout.sweep("mine", "smoke")
    content = json.loads(path.read_text())
    content["jobs"] = [dataclasses.asdict(job) for job in (*jobs, *later)]
    path.write_text(json.dumps(content))
    assert read_sweeps(layout) == [union]
