"""The job that deploys what a run has kept: in pieces or at once, it comes to the same episodes and rows."""

import pytest

from rrm.checkpoint import encode
from rrm.config import EvaluationConfig, ExplorationConfig, RewardConfig, SacConfig
from rrm.errors import MissingResultError
from rrm.files import write_atomically
from rrm.robot.config import DeployConfig, RigConfig
from rrm.robot.record import FILE, Record
from rrm.seeding import Streams
from rrm.training.build import build_agent
from rrm.training.deployments import deploy_kept
from rrm.training.kinds import DeploymentConfig, kept_networks
from rrm.training.run_config import RunConfig
from tests.robot import robot

pytestmark = [robot, pytest.mark.slow]

STEPS = (30, 60)
POLICY = RunConfig(
    profile="test", task="panda-reach", seed=0, steps=60, horizon=6, reward=RewardConfig(learner="true"),
    agent=SacConfig(hidden=8, layers=1, batch=16), exploration=ExplorationConfig(seed_steps=20),
    evaluation=EvaluationConfig(every=30, episodes=1), deploy=DeployConfig(checkpoints=STEPS),
).canonical()  # fmt: skip
CONFIG = DeploymentConfig(
    profile="test", task="panda-reach", seed=0, policy=POLICY, episodes=2,
    rig=RigConfig(width=480, height=360, boards=8),
)  # fmt: skip


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """What a run leaves that has kept two policies, neither of which has learned anything."""
    folder = tmp_path_factory.mktemp("policy")
    (folder / "networks").mkdir()
    for step in STEPS:
        networks = {"agent": build_agent(POLICY, Streams(step)).state_dict()}
        write_atomically(folder / kept_networks(step, POLICY.steps), encode(networks))
    return {POLICY.identity: folder}


@pytest.fixture(scope="module")
def straight(results, tmp_path_factory):
    """The episodes of an undisturbed job, and its rows."""
    from tests.rrm.training.conftest import Recorder

    folder, monitor = tmp_path_factory.mktemp("straight"), Recorder()
    assert deploy_kept(CONFIG, folder, monitor, results)
    assert set(monitor.beats) <= set(range(61))
    assert monitor.beats == sorted(monitor.beats)
    return episodes(folder), monitor.numbers()


def episodes(folder):
    return Record.read(folder / FILE, CONFIG.identity).episodes


def test_each_policy_plays_all_its_episodes(straight):
    """A row a policy, at the step it comes from: by the truth, with what the cameras made of it among the figures."""
    played, rows = straight
    assert {step: [each.number for each in own] for step, own in played.items()} == {30: [0, 1], 60: [0, 1]}
    assert all(each.steps == each.acted == 6 for own in played.values() for each in own)
    assert played[30] != played[60]
    first, last = rows
    assert first.startswith("EvalRow(step=30, episodes=2, ")
    assert last.startswith("EvalRow(step=60, episodes=2, ")
    assert all("'deployed_success_seen': 0.0" in row and "'deployed_lost': 0.0" in row for row in rows)


def test_stopped_in_the_middle_of_episodes_it_goes_on(straight, recorder, results, tmp_path):
    """The one under way is played again from its beginning; what is there is not, and the same comes of it."""
    counts, monitor = [], recorder()
    for monitor.patience in (9, 15, 100):  # an episode has six steps
        finished = deploy_kept(CONFIG, tmp_path, monitor, results)
        counts.append((finished, sum(map(len, episodes(tmp_path).values()))))
    assert counts == [(False, 1), (False, 3), (True, 4)]
    assert (episodes(tmp_path), monitor.numbers()) == straight
    told = recorder()
    assert deploy_kept(CONFIG, tmp_path, told, {})
    assert told.numbers() == straight[1]  # of what is there nothing is needed


def test_a_damaged_record_is_set_aside_and_played_again(straight, recorder, results, tmp_path):
    """It is said; what it held is not lost."""
    path = tmp_path / FILE
    Record(path, CONFIG.identity).add(30, straight[0][30][1])
    path.write_bytes(torn := path.read_bytes()[:-20])
    monitor = recorder(patience=9)
    assert not deploy_kept(CONFIG, tmp_path, monitor, results)
    (note,) = monitor.notes
    assert note.startswith(f"{path} cannot be read as episodes: ")
    assert note.endswith("set aside as episodes.corrupt, and played again")
    assert (tmp_path / "episodes.corrupt").read_bytes() == torn
    assert episodes(tmp_path) == {30: straight[0][30][:1]}


def test_networks_that_are_gone_or_damaged(recorder, results, tmp_path):
    """One message, which names the file and the run's folder to train anew; the arm has not moved."""
    folder = tmp_path / "run"
    kept = folder / "networks" / "30.safetensors"
    kept.parent.mkdir(parents=True)
    with pytest.raises(MissingResultError, match=rf"{kept}, the policy's networks, is missing: .* remove {folder} and"):
        deploy_kept(CONFIG, tmp_path, recorder(), {POLICY.identity: folder})
    whole = (results[POLICY.identity] / "networks" / "30.safetensors").read_bytes()
    kept.write_bytes(whole[:-1] + bytes([whole[-1] ^ 1]))
    with pytest.raises(MissingResultError, match=rf"{kept}, the policy's networks, is damaged .* remove {folder} and"):
        deploy_kept(CONFIG, tmp_path, recorder(), {POLICY.identity: folder})
    assert not (tmp_path / FILE).exists()


def test_a_record_that_cannot_be_read_now_stays_where_it_is(recorder, results, tmp_path):
    """That says nothing of what it holds: the job ends, and another time it may go on."""
    path = tmp_path / FILE
    path.symlink_to(path)
    with pytest.raises(OSError, match="symbolic links"):
        deploy_kept(CONFIG, tmp_path, recorder(), results)
    assert path.is_symlink()
