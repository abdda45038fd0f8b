"""The manifest sim-to-real as typed: training, kept networks, deployments, the table; killed and gone on with."""

import os
import random
import signal
import time
from pathlib import Path

import pytest

from rrm.robot.record import FILE, Record
from rrmctl.store import planned
from rrmctl.store.layout import Layout
from rrmctl.store.status import RunState, read_status, run_status
from rrmctl.store.sweeps import read_sweeps
from tests.robot import robot
from tests.rrmctl.cli.test_labels_command import numbers
from tests.rrmctl.cli.test_run import EXPERIMENTS, call, start

pytestmark = [robot, pytest.mark.slow, pytest.mark.sim]

ASKED = [
    "sim-to-real", "--experiments", str(EXPERIMENTS), "--profile", "smoke", "--seeds", "1", "--methods", "rrm-h2o",
    "--tasks", "panda-push", "--set", "deploy.episodes=2", "--set", "horizon=20",
]  # fmt: skip


@pytest.mark.long
def test_from_nothing_to_the_table_killed_and_resumed(tmp_path: Path) -> None:
    """Curves, kept networks and deployed episodes end as undisturbed, bit for bit, and nothing is done twice."""
    quiet, loud = Layout(tmp_path / "quiet"), Layout(tmp_path / "loud")
    assert call("run", *ASKED, "--results", quiet.root).exit_code == 0
    (sweep,) = read_sweeps(quiet)
    (job,), (deployment,) = sweep.jobs, sweep.deployments
    assert deployment.requires == (job.id,)
    rng, kills = random.Random(0), 0
    while kills < 6:
        program = start("run", *ASKED, "--workers", "1", "--results", loud.root)
        time.sleep(rng.uniform(2, 9))
        if program.poll() is not None:
            break
        for run in loud.run_ids():
            status = read_status(loud.run(run))
            if status.state is RunState.RUNNING and status.pid is not None:
                os.kill(status.pid, signal.SIGKILL)
                kills += 1
        os.killpg(program.pid, signal.SIGKILL)
        program.communicate()
    assert call("resume", "--results", loud.root).exit_code == 0
    assert numbers(loud.root, "sim-to-real") == numbers(quiet.root, "sim-to-real")
    for step in (240, 360, 480):
        name = f"networks/{step}.safetensors"
        assert (loud.run(job.id).path / name).read_bytes() == (quiet.run(job.id).path / name).read_bytes()
    records = [Record.read(layout.run(deployment.id).path / FILE, deployment.id) for layout in (quiet, loud)]
    assert records[0].episodes == records[1].episodes
    assert {step: len(played) for step, played in records[0].episodes.items()} == {240: 2, 360: 2, 480: 2}
    table = call("report", "sim-to-real", "--format", "csv", "--results", loud.root).stdout
    assert table.count("\n") == 1 + 3 * 2  # checkpoints with success and return
    assert "deployed at the simulated rig" in call("report", "sim-to-real", "--results", loud.root).stdout
    assert set(planned(loud.root, "sim-to-real")["method"]) == {"rrm-h2o"}  # comparisons know no deployments
    assert set(planned(loud.root, "sim-to-real", needed=True)["method"]) == {"rrm-h2o deployed"}
    again = call("run", *ASKED, "--results", loud.root)
    assert "2 done already" in again.stderr
    assert "Every run is asked for" in call("clean", "--results", loud.root).output
    attempts = run_status(loud.run(deployment.id)).attempt
    assert call("run", *ASKED, "--force", "--results", loud.root).exit_code == 0
    assert run_status(loud.run(deployment.id)).attempt == attempts + 1  # its networks are others
