"""From an expert to the prior it leaves and to the encoder that is lent, on a task with a camera."""

import os

import numpy as np
import pytest
import torch

from rrm.checkpoint import decode
from rrm.config import (
    CameraConfig,
    DrqConfig,
    EvaluationConfig,
    ExplorationConfig,
    FeedbackConfig,
    ImitationConfig,
    RewardConfig,
    SurfConfig,
)
from rrm.envs.observer import Observer
from rrm.errors import ConfigError, DemosError, MissingResultError, PriorError
from rrm.imitation.demos import Demonstrations, film_of
from rrm.imitation.visual import Eye
from rrm.priors.imitation import ImitationPrior
from rrm.seeding import Streams
from rrm.training.jobs import perform, train
from rrm.training.kinds import DemosConfig
from rrm.training.loop import Trainer
from rrm.training.run_config import RunConfig
from tests.rrm.training.conftest import Recorder

REPEAT = 2
AGENT = DrqConfig(
    kind="drqv2", hidden=16, layers=1, batch=8, channels=4, strides=(2, 2), features=8, shift=1, stddev_steps=200
)  # fmt: skip
IMITATION = ImitationConfig(seed_steps=40, every=20, updates=2, minibatch=8, hidden=16, layers=1, window=60, lr=1e-2)


def config(learner, reward=None, agent=None, **fields):
    """A run of 120 steps, 60 actions, on pictures of 16 x 16."""
    given = {
        "profile": "test", "task": "toy-car-image", "seed": 0, "steps": 120, "horizon": 20, "action_repeat": REPEAT,
        "camera": CameraConfig(size=16), "agent": AGENT.model_copy(update=agent or {}),
        "reward": RewardConfig(learner=learner, hidden=16, layers=1, epochs=3, **(reward or {})),
        "feedback": FeedbackConfig(every=40, batch=4, budget=8, segment=10),
        "exploration": ExplorationConfig(seed_steps=40, reset_updates=2),
        "evaluation": EvaluationConfig(every=60, episodes=1),
    }  # fmt: skip
    return RunConfig(**given | fields).canonical()


@pytest.fixture(scope="module")
def chain(tmp_path_factory):
    """Folders of finished runs by identity, and the configurations by name."""
    expert = config("true")
    demos = DemosConfig(
        task="toy-car-image", expert=expert, episodes=3, least_success=0.0, camera=expert.camera
    ).canonical()
    airl = config("airl", imitation=IMITATION.model_copy(update={"demos_run": demos.identity}))
    configs = {"expert": expert, "demos": demos, "airl": airl}
    folders = {each.identity: tmp_path_factory.mktemp(name) for name, each in configs.items()}
    for each in configs.values():
        assert perform(each, folders[each.identity], Recorder(), folders)
    on_it = {"encoder": "imitation", "encoder_run": airl.identity}
    configs["rrm-imitation"] = config("pebble", {"prior": "imitation", "prior_run": airl.identity}, on_it)
    configs["pebble"] = config("pebble", agent=on_it)
    configs["rrm-surf"] = config(
        "surf", {"prior": "proxy", "surf": SurfConfig(threshold=0.5, margin=1, crop=1, unlabelled=4)}
    )
    return folders, configs


def kept(chain):
    folders, configs = chain
    return decode((folders[configs["airl"].identity] / "model.safetensors").read_bytes())["imitation"]


@pytest.mark.parametrize("name", ["airl", "rrm-imitation", "pebble", "rrm-surf"])
def test_a_run_in_pieces_is_the_run(chain, tmp_path, networks, name):
    """Stopped every 13 actions and resumed: rows and networks are equal bit for bit."""
    folders, configs = chain
    straight, together, finished = Recorder(), Recorder(), False
    assert train(configs[name], tmp_path / "a", straight, folders)
    while not finished:
        piece = Recorder(13)
        finished = train(configs[name], tmp_path / "b", piece, folders)
        together.rows |= piece.rows
    assert straight.numbers() == together.numbers()
    assert networks(tmp_path / "a") == networks(tmp_path / "b")


def test_demonstrations_are_what_the_expert_saw(chain):
    """One picture of every state; the same instances, played again by actions that last as long, show the same."""
    folders, configs = chain
    demos = Demonstrations.load(folders[configs["demos"].identity] / "demos.safetensors")
    assert demos.lengths.tolist() == [10, 10, 10]
    assert len(demos.frames) == 33
    env = Observer("toy-car-image", 20, configs["expert"].spaces.frames, REPEAT)
    agent = Trainer(configs["expert"]).agent
    agent.load_state_dict(decode((folders[configs["expert"].identity] / "model.safetensors").read_bytes())["agent"])
    rng, numbers = Streams(0).numpy("demonstrations"), iter(range(30))
    for _ in range(3):
        obs, over = env.reset(seed=int(rng.integers(2**31))), False
        while not over:
            batch = demos.batch(torch.tensor([next(numbers)]))
            act = agent.act(obs, explore=False)
            np.testing.assert_array_equal(batch.act[0], act)
            np.testing.assert_array_equal(batch.frames[0, :3], obs.frames)
            obs, _, _, over, _ = env.step(act)
            np.testing.assert_array_equal(batch.frames[0, 1:], obs.frames)
            np.testing.assert_array_equal(batch.next_obs[0], obs.state)
    env.close()


def test_the_borrowed_encoder_is_the_discriminators(chain):
    """Agent and learned reward begin with it, and whoever asks for a fresh one does not."""
    folders, configs = chain
    lent = kept(chain)["encoder"]
    for name in ("rrm-imitation", "pebble"):
        trainer = Trainer(configs[name], folders)
        assert torch.equal(trainer.agent.encoder.flat, lent)
        assert torch.equal(trainer.experience.seen._encoder.flat, lent)
        trainer.close()
    reward = {"prior": "imitation", "prior_run": configs["airl"].identity}
    fresh = Trainer(config("pebble", reward, {"encoder": "fresh"}), folders)
    assert not torch.equal(fresh.agent.encoder.flat, lent)
    fresh.close()
    assert not torch.equal(
        Trainer(configs["airl"], folders).sources["adversarial"].discriminator.eye.encoder.flat, lent
    )


def test_another_encoder_or_camera_is_refused(chain):
    """The message names the file and both shapes."""
    folders, configs = chain
    on_it = {"encoder": "imitation", "encoder_run": configs["airl"].identity}
    for changes in ({"agent": on_it | {"channels": 5}}, {"agent": on_it, "camera": CameraConfig(size=20)}):
        with pytest.raises(ConfigError, match=r"agent\.encoder: that of .*model\.safetensors has 4 channels .* 16 x"):
            Trainer(config("pebble", **changes), folders)
    airl = folders[configs["airl"].identity] / "model.safetensors"
    with pytest.raises(PriorError, match=r"judges by 3 x 16 x 16 from above .*; this run's agent sees no frames"):
        ImitationPrior(airl, configs["airl"].spec())
    on_an_expert = config("pebble", agent=on_it | {"encoder_run": configs["expert"].identity})
    with pytest.raises(MissingResultError, match="holds no imitation prior"):
        Trainer(on_an_expert, folders)


def test_the_prior_is_g_of_what_was_seen(chain):
    """Of the state before the step: the kept nets, written out in plain code."""
    folders, configs = chain
    prior = kept(chain)
    eye = Eye.kept(prior)
    trainer = Trainer(configs["rrm-imitation"], folders)
    for _ in range(30):
        trainer.advance()
    experience = trainer.experience
    rows = experience.since(0)
    stacks = torch.stack([experience.stacks(int(row), int(row) + 1)[0] for row in rows])
    with torch.no_grad():
        features = eye.projection.plain(eye.encoder.plain(stacks))[0].t()
        centred = features - features.mean(1, keepdim=True)
        normal = centred / (features.var(1, correction=0, keepdim=True) + 1e-5).sqrt()
        seen = torch.cat((torch.tanh(normal), experience.obs[rows, :4], experience.act[rows]), dim=1)
        g = trainer.prior._prior._g.net.plain(seen)[0, 0]
    expected = torch.tanh((g - prior["mean"]) / prior["std"])
    torch.testing.assert_close(experience.raw_prior[rows], expected, rtol=1e-4, atol=1e-5)
    assert expected.std() > 0
    trainer.close()


def test_the_agent_is_trained_on_the_present_reward_of_every_step(chain):
    """A window's rewards are those of its transitions one by one, over the running deviation."""
    folders, configs = chain
    trainer = Trainer(configs["airl"], folders)
    for _ in range(40):
        trainer.advance()
    source, experience = trainer.sources["adversarial"], trainer.experience
    batch = experience.batch_of_windows(torch.arange(experience.windows))
    single = experience.batch(torch.arange(experience.transitions))
    rewards = dict(zip(experience.since(0).tolist(), source.discriminator.f(single).tolist(), strict=True))
    rows = experience._window_of[: experience.windows, None] + torch.arange(experience.window)
    expected = torch.tensor([[rewards[row] for row in window] for window in rows.tolist()])
    torch.testing.assert_close(source.discriminator.f(batch), expected, rtol=1e-4, atol=1e-5)
    trainer.close()


@pytest.mark.parametrize("harm", ["changed", "short", "missing", "pipe"])
def test_damaged_pictures_are_refused(chain, tmp_path, harm):
    """With the file that is of no use, and what to do."""
    folders, configs = chain
    source = folders[configs["demos"].identity] / "demos.safetensors"
    copy = tmp_path / "demos.safetensors"
    copy.write_bytes(source.read_bytes())
    film = bytearray(film_of(source).read_bytes())
    if harm == "changed":
        film[1000] ^= 1
    if harm == "pipe":
        os.mkfifo(film_of(copy))
    elif harm != "missing":
        film_of(copy).write_bytes(film[:-1] if harm == "short" else film)
    with pytest.raises(DemosError, match=r"pictures of the demonstrations cannot be read: .*safetensors\.frames: "):
        Demonstrations.load(copy)
    again = r"demos\.safetensors\.frames: .*: bring it back, or remove .* --retry-failed"
    with pytest.raises(MissingResultError, match=again):
        Trainer(configs["airl"], folders | {configs["demos"].identity: tmp_path})


def test_the_pictures_of_another_run_are_left_as_they_are(chain, tmp_path):
    """Not cut where more was written behind them, and opened to be read alone."""
    folders, configs = chain
    source, copy = folders[configs["demos"].identity] / "demos.safetensors", tmp_path / "mine.safetensors"
    copy.write_bytes(source.read_bytes())
    film_of(copy).write_bytes(film_of(source).read_bytes() + b"more")
    demos = Demonstrations.load(copy)
    assert film_of(copy).read_bytes()[-4:] == b"more"
    with pytest.raises(OSError, match="frames"):
        demos.frames.append(np.zeros(demos.frames.shape, np.uint8))


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"camera": CameraConfig(size=20)}, r"holds pictures of 3 x 16 x 16 from above .*sees 3 x 20 x 20 from above"),
        ({"action_repeat": 1}, "an action lasts 2 steps, not action_repeat = 1"),
    ],
)
def test_demonstrations_that_do_not_fit_are_refused(chain, changes, problem):
    """Seen otherwise, or by actions that last otherwise."""
    folders, configs = chain
    imitation = IMITATION.model_copy(update={"demos_run": configs["demos"].identity})
    with pytest.raises(DemosError, match=problem):
        Trainer(config("airl", imitation=imitation, **changes), folders)
