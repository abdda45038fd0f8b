"""`rrmctl deploy RUN`: episodes at the simulated workplace that stay, and one message where there are none to play."""

from __future__ import annotations

import dataclasses
import json
import shutil
import signal
import subprocess
from pathlib import Path

import pytest
from typer.testing import Result

from rrm.config import DrqConfig, ExplorationConfig, RewardConfig
from rrm.robot.deployment import Episode
from rrm.robot.record import Record
from rrm.training.kinds import DemosConfig
from rrm.training.run_config import JobConfig, RunConfig
from rrmctl.running.config_file import config_content
from rrmctl.store.files import try_lock
from rrmctl.store.layout import Layout, RunFolder
from rrmctl.store.provenance import record_config
from rrmctl.store.status import RunState, read_status, write_status
from tests.robot import robot
from tests.rrmctl.cli.test_robot import MANIFEST, WITHOUT, python
from tests.rrmctl.cli.test_run import PROGRAM, call

pytestmark = [robot, pytest.mark.slow]

TRAINING = (
    "steps=60", "horizon=6", "agent.hidden=8", "exploration.seed_steps=20", "evaluation.every=60",
    "evaluation.episodes=1", "deploy.checkpoints=[30, 60]",
)  # fmt: skip
SMALL = ("--set", "rig.width=480", "--set", "rig.height=360", "--set", "rig.boards=8")


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> RunFolder:
    """A run of a policy that reaches nothing, done in a second; it has kept step 30."""
    root = tmp_path_factory.mktemp("trained")
    (root / "arm.toml").write_text(MANIFEST)
    settings = (word for setting in TRAINING for word in ("--set", setting))
    asked = ("--profile", "smoke", "--methods", "oracle", "--seeds", "1", "--workers", "1", *settings)
    done = call("run", root / "arm.toml", *asked, "--results", root / "results")
    assert done.exit_code == 0, done.stderr
    layout = Layout(root / "results")
    return layout.run(layout.run_ids()[0])


@pytest.fixture
def run(trained: RunFolder, tmp_path: Path) -> RunFolder:
    """A copy of it, to do with as one likes."""
    shutil.copytree(trained.results, tmp_path / "results")
    return Layout(tmp_path / "results").run(trained.id)


def words(folder: RunFolder, *arguments: str) -> list[str]:
    return ["deploy", folder.id[:7], "--results", str(folder.results), *SMALL, *arguments]


def deploy(folder: RunFolder, *arguments: str) -> Result:
    return call(*words(folder, *arguments))


def played(folder: RunFolder, step: int = 60) -> list[Episode]:
    (path,) = folder.deployments.glob(f"{step}-*.parquet")
    return Record.read(path).of(step)


def refused(done: Result, *messages: str) -> None:
    """Exit code 2 and one message."""
    assert done.exit_code == 2, done.output
    assert "Traceback" not in done.output
    assert done.stderr.count("error: ") == 1
    assert all(message in done.stderr for message in messages), done.stderr


def test_episodes_are_played_once_and_stay(run: RunFolder) -> None:
    """A line each and a summary; asked again they are told from the record, and only what is missing is played."""
    first = deploy(run, "--episodes", "1")
    assert first.exit_code == 0, first.stderr
    line, summary = first.stdout.splitlines()
    assert line.startswith("episode   0: failure, return -")
    assert summary.startswith("success 0% of 1, 95 % interval 0% to 79%; return -")
    whole = deploy(run, "--json", "--episodes", "2")
    facts = json.loads(whole.stdout)
    assert "note: 1 of 2 episodes are there: " in whole.stderr
    assert facts["played"] == [dataclasses.asdict(episode) for episode in played(run)]
    assert [episode["number"] for episode in facts["played"]] == [0, 1]
    assert (facts["run"], facts["step"], facts["episodes"], facts["lost"]) == (run.id, 60, 2, 0)
    assert facts["rig"]["width"] == 480
    file = Path(facts["file"])
    written = file.stat().st_mtime_ns
    for count in (2, 1):
        again = deploy(run, "--episodes", str(count))
        assert "calibrated" not in again.stderr
        assert again.stdout.splitlines()[0] == line
        assert len(again.stdout.splitlines()) == count + 1
    assert file.stat().st_mtime_ns == written
    Record(run.episodes, "a job's").add(30, played(run)[0])
    shown = json.loads(call("show", run.id, "--results", run.results, "--json").stdout)
    assert shown["networks"] == [30]
    own, entry = shown["deployments"]
    assert (own["step"], own["episodes"], own["file"]) == (30, 1, "episodes.parquet")
    assert entry == {"step": 60, "file": f"deployments/{file.name}"} | {
        name: facts[name] for name in entry.keys() & facts.keys() - {"file"}
    }
    text = call("show", run.id, "--results", run.results).stdout
    assert "networks kept\nof steps 30\n" in text
    assert "step        60  success 0% of 2, 95 % interval 0% to 66%; return -" in text
    file.write_bytes(file.read_bytes()[:-9])
    refused(deploy(run, "--episodes", "3"), f"{file} cannot be read as episodes: ", "hint: move it away")
    assert "cannot be read as episodes" in call("show", run.id, "--results", run.results).stdout


@pytest.fixture(scope="module")
def straight(trained: RunFolder, tmp_path_factory: pytest.TempPathFactory) -> list[Episode]:
    """Three episodes in one piece."""
    root = tmp_path_factory.mktemp("straight") / "results"
    shutil.copytree(trained.results, root)
    folder = Layout(root).run(trained.id)
    done = deploy(folder, "--episodes", "3")
    assert done.exit_code == 0, done.stderr
    return played(folder)


@pytest.mark.parametrize(("number", "code"), [(signal.SIGKILL, -9), (signal.SIGINT, 75)])
def test_whatever_stops_it_the_same_command_goes_on(
    run: RunFolder, straight: list[Episode], number: signal.Signals, code: int
) -> None:
    """What was played stays, nothing is played twice, and another that is asked for the same meanwhile is refused."""
    command = [*PROGRAM, *words(run, "--episodes", "3")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as program:
        assert program.stdout is not None
        assert program.stdout.readline().startswith("episode   0: ")
        program.send_signal(signal.SIGSTOP)
        refused(deploy(run, "--episodes", "3"), f"another process deploys step 60 of run {run.id}", "hint: wait for it")
        program.send_signal(number)
        program.send_signal(signal.SIGCONT)
        _, said = program.communicate(timeout=60)
    assert program.returncode == code, said
    assert "Traceback" not in said
    assert (said.splitlines()[-1] == "Not complete: the same command goes on.") is (number is signal.SIGINT)
    assert 1 <= len(there := played(run)) < 3
    done = deploy(run, "--episodes", "3")
    assert done.exit_code == 0, done.stderr
    assert f"note: {len(there)} of 3 episodes are there" in done.stderr
    assert played(run) == straight


def test_a_run_that_is_not_done_deploys_what_it_has_kept(run: RunFolder) -> None:
    """Not its end, and nothing else; what there is is said."""
    write_status(run, dataclasses.replace(read_status(run), state=RunState.INTERRUPTED))
    refused(deploy(run), f"run {run.id} is interrupted", "hint: --checkpoint takes 30\n")
    refused(deploy(run, "--checkpoint", "60"), f"run {run.id} has kept no networks of step 60", "takes 30\n")
    done = deploy(run, "--checkpoint", "30", "--episodes", "1")
    assert done.exit_code == 0, done.stderr
    assert len(played(run, 30)) == 1
    shutil.rmtree(run.networks)
    refused(deploy(run, "--checkpoint", "30"), "has kept no networks of step 30", "hint: it has kept none so far")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--checkpoint", "31"), "has kept no networks of step 31\nhint: --checkpoint takes 30, 60\n"),
        (("--set", "rig.widht=320"), '--set rig.widht: unknown setting "rig.widht"; did you mean "rig.width"?'),
        (("--set", "agent.batch=256"), '--set agent.batch: unknown setting "agent.batch"\nhint: a rig has: rig.seed, '),
        (("--set", "rig={}"), '--set rig: unknown setting "rig"'),
        (("--set", "rig.width=10"), "rig.width = 10: Input should be greater than or equal to 160"),
        (("--set", "rig.friction=[2, 1]"), "rig.friction = [2, 1]: "),
        (("--set", "rig.blur"), "--set rig.blur: expected rig.KEY=VALUE, e.g. --set rig.blur=2"),
        (("--set", "rig.width=160", "--set", "rig.height=120"), "front: the board of 7 x 5 squares"),
        (("--set", "rig.dictionary=DICT_9"), 'unknown marker dictionary "DICT_9"'),
    ],
)
def test_what_is_asked_for_is_not_there(run: RunFolder, arguments: tuple[str, ...], message: str) -> None:
    refused(deploy(run, *arguments), message)
    assert not list(run.deployments.glob("*.parquet"))


def test_no_such_run(run: RunFolder) -> None:
    refused(call("deploy", "ffff", "--results", run.results), "starts with 'ffff'")
    refused(call("deploy", run.id, "--results", run.results / "none"), "there is no results folder")


REST = {"seed": 0, "steps": 60, "reward": RewardConfig(learner="true"), "exploration": ExplorationConfig(seed_steps=20)}
CAR = RunConfig(task="toy-car", **REST)


@pytest.mark.parametrize(
    ("config", "message"),
    [
        (CAR, "a policy of toy-car has nothing to do at an arm; those of panda-reach, "),
        (
            RunConfig(task="toy-car-image", **REST, agent=DrqConfig(kind="drqv2")),
            "a policy of toy-car-image has nothing to do at",
        ),
        (RunConfig(task="panda-reach", **REST, action_repeat=2), "action_repeat 2; an arm is told at every step"),
        (DemosConfig(task="toy-car", seed=0, expert=CAR), "(toy-car, demos) trains no policy"),
    ],
    ids=["another task", "pictures", "repeated actions", "no policy"],
)
def test_runs_that_an_arm_has_no_use_for(tmp_path: Path, config: JobConfig, message: str) -> None:
    folder = Layout(tmp_path).run(config.identity)
    record_config(folder, config_content(config))
    refused(deploy(folder), message)
    assert not folder.deployments.exists()


def test_networks_that_are_damaged_or_gone(run: RunFolder) -> None:
    """Which file, and what to do; before anything is calibrated or moves."""
    for step, path in ((30, run.networks / "30.safetensors"), (60, run.model)):
        data = path.read_bytes()
        path.write_bytes(data[:-1] + bytes([data[-1] ^ 1]))
        again = f"bring it back, or remove {run.path} and run the experiment again"
        done = deploy(run, "--checkpoint", str(step))
        refused(done, f"{path}, the policy's networks, is damaged", again)
    run.model.unlink()
    refused(deploy(run), f"{run.model}, the policy's networks, is missing: {again}")


def test_without_pybullet(run: RunFolder, tmp_path: Path) -> None:
    """What to install, as `run` says it."""
    done = python(tmp_path, f"{WITHOUT}\nfrom rrmctl.cli.app import main; main()", *words(run))
    assert done.returncode == 2
    assert done.stderr.startswith("error: panda-reach needs pybullet, which is not installed")
    assert done.stderr.endswith("pip install 'rrmctl[robot]'\n")
    assert not run.deployments.exists()


def test_a_rig_that_dies_again_and_again(run: RunFolder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One message with its last words, exit code 1; whoever comes next may play."""
    (tmp_path / "pybullet.py").write_text("raise SystemExit('no table today')")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    done = deploy(run)
    assert done.exit_code == 1, done.output
    assert "error: episode 0, 3 times in a row: the rig ended (code 1): no table today\n" in done.stderr
    assert "hint: what was played before stays" in done.stderr
    assert "Traceback" not in done.output
    (lock,) = run.deployments.iterdir()
    assert try_lock(lock) is not None


def test_help_names_the_run_and_the_other_command() -> None:
    """A run is deployed by its id alone; what it is called in help works too, and options may come first."""
    group, own = (call("deploy", *arguments, "--help").stdout for arguments in ((), ("2dcd",)))
    assert "RUN" in group
    assert "calibrate" in group
    assert "Usage: rrmctl deploy RUN [OPTIONS]" in own.replace("root ", "rrmctl ")
    assert call("deploy", "RUN", "--help").stdout == own
    assert call("deploy", "--checkpoint", "0", "2dcd").exit_code == 2
