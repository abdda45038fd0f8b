"""From an expert to the prior it leaves, and to the runs that start from it."""

import json
import shutil

import numpy as np
import pyarrow.parquet as pq
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from rrm.checkpoint import decode, encode
from rrm.config import (
    EvaluationConfig,
    ExplorationConfig,
    FeedbackConfig,
    ImitationConfig,
    RewardConfig,
    SacConfig,
)
from rrm.envs import task
from rrm.errors import ConfigError, DemosError, MissingResultError, PriorError
from rrm.imitation.demos import Demonstrations
from rrm.imitation.discriminator import RewardNet
from rrm.priors.imitation import ImitationPrior
from rrm.priors.values import PriorSource
from rrm.registry import file_digest
from rrm.seeding import Streams
from rrm.training.build import build_reward, result_of
from rrm.training.jobs import collect, perform, train
from rrm.training.kinds import DemosConfig
from rrm.training.loop import Trainer
from rrm.training.run_config import RunConfig
from rrm.types import Obs

IMITATION = ImitationConfig(
    seed_steps=100, every=50, updates=4, minibatch=8, hidden=16, layers=1, window=150, switch=300
)


@pytest.fixture
def expert(tiny):
    return tiny(learner="true", steps=200, evaluation=EvaluationConfig(every=200, episodes=1))


@pytest.fixture
def results(expert, recorder, tmp_path):
    """Folders of a finished oracle and of demonstrations of it; the configuration of the latter under "demos"."""
    demos = DemosConfig(task="toy-car", expert=expert, episodes=3, least_success=0.0)
    folders = {config.identity: tmp_path / config.method for config in (expert, demos)}
    for config in (expert, demos):
        folders[config.identity].mkdir()
        assert perform(config, folders[config.identity], recorder(), folders)
    return folders | {"demos": demos}


@pytest.fixture
def imitating(tiny, results):
    """Makes a run that begins with those demonstrations."""

    def make(learner="airl", **fields):
        imitation = IMITATION.model_copy(update={"demos_run": results["demos"].identity} | fields.pop("imitation", {}))
        return tiny(learner=learner, imitation=imitation, steps=fields.pop("steps", 500), **fields)

    return make


@pytest.fixture
def prior(imitating, results, recorder, tmp_path):
    """A finished AIRL run, added to the results; its configuration."""
    config = imitating()
    results[config.identity] = tmp_path / "airl"
    told = recorder()
    assert train(config, results[config.identity], told, results)
    assert [note for note in told.notes if "the prior is g of step" in note and "on the policy" in note]
    return config


METHODS = {
    "airl": {},
    "mse": {"imitation": {"pretrain": "mse", "head": "tanh"}},
    "finetune": {"learner": "finetune"},
    "finetune-tanh": {"learner": "finetune", "imitation": {"head": "tanh"}},
}


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("patience", [1, 73])
def test_a_run_in_pieces_is_the_run(imitating, results, recorder, networks, tmp_path, method, patience):
    """Stopped every n steps and resumed: rows, networks, the prior and the gradients are equal bit for bit."""
    fields = METHODS[method]
    if patience == 1:
        early = {"seed_steps": 50, "every": 20, "switch": 130}
        fields = fields | {"steps": 150, "imitation": fields.get("imitation", {}) | early}
    config = imitating(**fields)
    straight, together = recorder(), recorder()
    assert train(config, tmp_path / "a", straight, results)
    finished = False
    while not finished:
        piece = recorder(patience)
        finished = train(config, tmp_path / "b", piece, results)
        together.rows |= piece.rows
    assert straight.numbers() == together.numbers()
    assert networks(tmp_path / "a") == networks(tmp_path / "b")
    if config.reward.kind.learned:
        tables = [pq.read_table(tmp_path / name / "gradients.parquet") for name in "ab"]
        assert tables[0].equals(tables[1])


def test_the_prior_is_g_of_the_kept_evaluation(prior, results):
    """The file says what it is, and the prior built from it returns g of the state before the step."""
    path = results[prior.identity] / "model.safetensors"
    kept = decode(path.read_bytes())["imitation"]
    assert (kept["task"], kept["seed"]) == ("toy-car", 0)
    assert kept["demonstrations"]["expert"] == results["demos"].expert.identity
    assert kept["step"] in (250, 500)
    loaded = ImitationPrior(path, prior.spec())
    row = np.linspace(-1, 1, 17, dtype=np.float32)

    class Step:
        obs, act = row[:15], row[15:]

    weights = kept["g"]
    hidden = torch.relu(torch.from_numpy(row) @ weights[: 17 * 16].view(17, 16) + weights[272:288])
    expected = (float(hidden @ weights[288:304] + weights[304]) - kept["mean"]) / kept["std"]
    assert loaded(Step()) == pytest.approx(np.tanh(expected), rel=1e-5)
    assert ImitationPrior(path, prior.spec(), "none")(Step()) == pytest.approx(expected, rel=1e-5)


@given(
    states=st.lists(st.floats(-1e4, 1e4, width=32), min_size=2, max_size=9),
    mean=st.floats(-1e6, 1e6),
    std=st.floats(0, 1e6),
)
def test_the_prior_is_bounded_from_the_first_step(tmp_path_factory, states, mean, std):
    """Whatever g says, and wherever it lay: within [-1, 1], in g's order, and so is what is stored of it."""
    spec, net = task("toy-car"), RewardNet(ImitationConfig(hidden=1, layers=1), 15, 2, None).net
    first, _, second, _ = (each.detach() for each in net.parameters())
    first[0, 0], second[0, 0] = 1.0, 1.0  # g is the first number observed, 0 where that is negative
    shape = {"shape": {"hidden": 1, "layers": 1, "head": "linear"}, "obs_dim": 15, "act_dim": 2}
    path = tmp_path_factory.mktemp("prior") / "model.safetensors"
    path.write_bytes(encode({"imitation": {"task": spec.name, **shape, "mean": mean, "std": std, "g": net.flat}}))
    prior, act = ImitationPrior(path, spec), np.zeros(2, np.float32)
    source = PriorSource("imitation", prior, "scale", spec, np.random.default_rng(0))
    source.begin_episode(np.zeros(15, np.float32))
    values = np.array([source(Obs(np.full(15, state, np.float32)), act, {}, 0) for state in states])
    assert (abs(values) <= 1).all()
    assert values[0, 0] == pytest.approx(np.tanh((max(states[0], 0) - mean) / (std or 1)), rel=1e-5, abs=1e-7)
    assert (np.diff(values[np.argsort(np.maximum(states, 0), kind="stable"), 0]) >= 0).all()


@pytest.mark.parametrize("learner", ["pebble", "prior"])
def test_a_run_on_the_prior_stores_it_normalised(tiny, prior, results, learner):
    """The residual model and the prior alone: as collected, over its running deviation where that exceeds 1."""
    config = tiny(learner=learner, steps=300, prior="imitation", prior_run=prior.identity, squash="none")
    trainer = Trainer(config, results)
    for _ in range(120):
        trainer.advance()
    rows = trainer.experience.since(0)
    kept = decode((results[prior.identity] / "model.safetensors").read_bytes())["imitation"]
    g = trainer.prior._prior._g.predict(trainer.experience.obs[rows], trainer.experience.act[rows])
    g = (g - kept["mean"]) / kept["std"]
    torch.testing.assert_close(trainer.experience.raw_prior[rows], g, rtol=1e-4, atol=1e-5)
    seen = g.double().numpy()
    deviation = np.array([1.0 if n < 2 else max(1.0, seen[:n].std(ddof=1)) for n in range(1, 121)])
    np.testing.assert_allclose(trainer.experience.prior[rows].numpy(), seen / deviation, rtol=1e-3, atol=1e-5)
    trainer.close()


def test_the_prior_is_part_of_the_identity(tiny):
    """Another prior, or another bound of it, is another run; to other priors neither means anything."""
    on = [tiny(prior="imitation", prior_run=run) for run in ("0" * 16, "1" * 16)]
    assert on[0].identity != on[1].identity
    assert on[0].identity != tiny(prior="imitation", prior_run="0" * 16, squash="none").identity
    assert on[0].requires == ("0" * 16,)
    assert tiny(prior="proxy", prior_run="0" * 16).identity == tiny(prior="proxy").identity
    assert tiny(prior="proxy", prior_run="0" * 16).requires == ()


def test_a_missing_or_foreign_prior_is_refused(tiny, prior, results, tmp_path):
    """Each says what is missing and where."""
    config = tiny(prior="imitation", prior_run=prior.identity)
    with pytest.raises(MissingResultError, match=f"the run {prior.identity} is needed first"):
        Trainer(config)
    with pytest.raises(MissingResultError, match="the run None is needed first"):
        result_of(results, None, "model.safetensors")
    path = results[prior.identity] / "model.safetensors"
    with pytest.raises(PriorError, match="was trained on toy-car, not on button-press"):
        ImitationPrior(path, task("button-press"))
    earlier = decode(path.read_bytes())
    del earlier["imitation"]["mean"], earlier["imitation"]["std"]
    (tmp_path / "earlier.safetensors").write_bytes(encode(earlier))
    with pytest.raises(PriorError, match="a prior of an earlier version: run the experiment again"):
        ImitationPrior(tmp_path / "earlier.safetensors", task("toy-car"))
    oracle = results[results["demos"].expert.identity] / "model.safetensors"
    with pytest.raises(MissingResultError, match="holds no imitation prior"):
        ImitationPrior(oracle, task("toy-car"))
    path.unlink()
    with pytest.raises(MissingResultError, match=f"is missing: .* remove {path.parent} and run the experiment again"):
        Trainer(config, results)


@pytest.mark.parametrize("kind", ["expert", "demonstrations", "prior"])
def test_a_changed_bit_in_what_an_earlier_run_left_is_refused(
    tiny, imitating, prior, results, recorder, tmp_path, kind
):
    """Before anything is made of it; the message names the file and says how to make it again."""
    demos = results["demos"]
    run, config, name = {
        "expert": (demos.expert.identity, demos, "model.safetensors"),
        "demonstrations": (demos.identity, imitating(), "demos.safetensors"),
        "prior": (prior.identity, tiny(prior="imitation", prior_run=prior.identity), "model.safetensors"),
    }[kind]
    path = results[run] / name
    data = bytearray(path.read_bytes())
    data[-30] ^= 1  # a last bit of some number
    path.write_bytes(data)
    told = f"{path}.*does not match its checksum.*: bring it back, or remove {path.parent} and run .* --retry-failed"
    with pytest.raises(MissingResultError, match=told):
        perform(config, tmp_path, recorder(), results)


def test_demonstrations_are_of_the_expert(results, recorder, tmp_path):
    """Its deterministic policy plays, from instances of their own; the same job makes the same bytes."""
    config = results["demos"]
    file = results[config.identity] / "demos.safetensors"
    demos = Demonstrations.load(file)
    assert demos.provenance["expert"] == config.expert.identity
    assert demos.lengths.tolist() == [50, 50, 50]
    (tmp_path / "again").mkdir()
    stopped = recorder(patience=1)
    assert not collect(config, tmp_path / "again", stopped, results)
    assert collect(config, tmp_path / "again", recorder(), results)
    assert (tmp_path / "again" / "demos.safetensors").read_bytes() == file.read_bytes()
    trainer = Trainer(config.expert)
    trainer.agent.load_state_dict(decode((results[config.expert.identity] / "model.safetensors").read_bytes())["agent"])
    for obs, act in zip(demos.obs[:5], demos.act[:5], strict=True):
        np.testing.assert_array_equal(trainer.agent.act(Obs(obs), explore=False), act)
    trainer.close()


def test_demonstrations_have_an_identity(expert):
    """Of the expert and of everything that changes them; as a configuration they survive JSON."""
    config = DemosConfig(task="toy-car", expert=expert)
    others = [
        config.model_copy(update={"episodes": 3}), config.model_copy(update={"seed": 1}),
        DemosConfig(task="toy-car", expert=expert.model_copy(update={"seed": 1})),
    ]  # fmt: skip
    assert len({each.identity for each in (config, *others)}) == 4
    assert DemosConfig.model_validate(json.loads(config.model_dump_json())).identity == config.identity
    assert config.requires == (expert.identity,)
    with pytest.raises(ValueError, match="shows nothing of door-open"):
        DemosConfig(task="door-open", expert=expert)


def test_demonstrations_without_their_expert(results, recorder, tmp_path):
    """What is missing is named."""
    config = results["demos"]
    shutil.rmtree(results[config.expert.identity])
    with pytest.raises(MissingResultError, match="the policy's networks, is missing"):
        collect(config, tmp_path, recorder(), results)


def test_a_file_of_ones_own(imitating, results, tmp_path):
    """It stands for no run; it counts by its content, wherever it lies; another task's is refused."""
    source = results[results["demos"].identity] / "demos.safetensors"
    paths = [tmp_path / name for name in ("a.safetensors", "b.safetensors")]
    for path in paths:
        shutil.copy(source, path)
    configs = [imitating(imitation={"demos": str(path)}) for path in paths]
    assert configs[0].identity == configs[1].identity
    assert configs[0].requires == ()
    assert configs[0].imitation.demos_digest == file_digest(paths[0], "")
    Trainer(configs[0]).close()
    demos = Demonstrations.load(source)
    Demonstrations(**vars(demos) | {"provenance": {"task": "door-open"}}).save(paths[1])
    other = imitating(imitation={"demos": str(paths[1])})
    assert other.identity != configs[0].identity
    with pytest.raises(DemosError, match="shows door-open, not toy-car"):
        Trainer(other)


def test_the_agent_is_trained_on_the_discriminators_present_reward(imitating, results):
    """Not on what was stored: overwriting every stored reward changes no weight."""
    trainers = [Trainer(imitating(), results) for _ in range(2)]
    for trainer in trainers:
        for step in range(200):
            trainer.advance()
            if trainer is trainers[1] and step % 10 == 0:
                trainer.experience.reward.fill_(1e6)
    first, second = (trainer.agent.state_dict()["tensors"] for trainer in trainers)
    assert all(torch.equal(first[name], second[name]) for name in ("actor", "critic"))
    for trainer in trainers:
        trainer.close()


def test_the_discriminator_sees_the_newest_transitions(imitating, results):
    """At its steps alone, from as many as the window holds."""
    trainer = Trainer(imitating(), results)
    seen = []
    replay = trainer.sources["adversarial"]._replay
    kept = replay.draw

    def draw(count, generator, *, newest=None, **options):
        if newest is not None:
            seen.append((trainer.step, newest))
        return kept(count, generator, newest=newest, **options)

    replay.draw = draw
    for _ in range(260):
        trainer.advance()
    assert sorted(set(seen)) == [(step, 150) for step in (100, 150, 200, 250)]
    assert len(seen) == 4 * 4
    trainer.close()


def test_the_window_leaves_older_transitions_out(imitating, results):
    """Of 200 transitions the newest 50 are those of the last 50 steps."""
    trainer = Trainer(imitating(), results)
    for _ in range(200):
        trainer.advance()
    experience, replay = trainer.experience, trainer.sources["adversarial"]._replay
    last = {tuple(row.tolist()) for row in experience.obs[experience.since(150)]}
    drawn = replay.draw(400, torch.Generator().manual_seed(0), newest=50)
    assert {tuple(row.tolist()) for row in drawn.obs} == last
    trainer.close()


def test_fine_tuning_goes_on_with_everything_but_the_loss(imitating, results):
    """At the switch g learns from preferences and relabels, in the reward's unit until then; agent, temperature and
    buffer are not reset.
    """
    config = imitating("finetune", feedback=FeedbackConfig(every=50, batch=10, budget=25, segment=10))
    trainer = Trainer(config, results)
    while trainer.step < 300:
        trainer.advance()
    agent, transitions = trainer.agent.state_dict(), trainer.experience.transitions
    critic = trainer.agent._adams["critic"].state_dict()["steps"].item()
    adversarial = trainer.sources["adversarial"]
    before, scale = adversarial.discriminator.state_dict(), adversarial.scale.state_dict()
    trainer.advance()
    assert trainer.agent.updates == agent["updates"] + 1
    assert trainer.agent._adams["critic"].state_dict()["steps"].item() == critic + 1
    assert trainer.experience.transitions == transitions + 1
    after = adversarial.discriminator.state_dict()
    assert not torch.equal(before["g"], after["g"])
    assert torch.equal(before["h"], after["h"])
    rows = trainer.experience.since(0)
    g = adversarial.discriminator.g.predict(trainer.experience.obs[rows], trainer.experience.act[rows])
    torch.testing.assert_close(trainer.experience.reward[rows], g / adversarial.scale.std)
    assert adversarial.scale.state_dict() == scale
    loaded, blank = build_reward(config, Streams(1)), torch.zeros(len(rows))
    loaded.load_state_dict(trainer.legacy()["reward"])
    given = loaded.predict(trainer.experience.obs[rows], trainer.experience.act[rows], blank)
    torch.testing.assert_close(given, trainer.experience.reward[rows])
    assert trainer.sources["preferences"].queries == 10
    trainer.close()


def test_every_gradient_of_both_phases_is_recorded(imitating, results, recorder, tmp_path):
    """Four steps every fifty before the switch; after it one for each minibatch of each epoch."""
    train(imitating("finetune"), tmp_path / "a", recorder(), results)
    table = pq.read_table(tmp_path / "a" / "gradients.parquet").to_pydict()
    pairs = list(zip(table["step"], table["loss"], strict=True))
    assert [step for step, loss in pairs if loss == "airl"] == [s for s in (100, 150, 200, 250) for _ in range(4)]
    preferred = [step for step, loss in pairs if loss == "preferences"]
    assert set(preferred) == {300, 450}
    assert 2 <= len(preferred) <= 6
    assert min(table["gradient_norm"]) > 0


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"reward": RewardConfig(learner="airl", prior="proxy")}, "takes no prior"),
        ({"reward": RewardConfig(learner="finetune", prior="proxy")}, "takes no prior"),
        ({"reward": RewardConfig(learner="airl"), "steps": 100}, r"before the first update; imitation\.seed_steps"),
        ({"reward": RewardConfig(learner="finetune"), "steps": 300}, "before the first feedback at 300"),
        (
            {"reward": RewardConfig(learner="finetune"), "imitation": IMITATION.model_copy(update={"switch": 120})},
            r"imitation\.switch: 120 comes before an episode",
        ),
    ],
)
def test_what_cannot_be_run_is_refused(fields, message):
    """The message names the key."""
    given = {"task": "toy-car", "seed": 0, "steps": 500, "horizon": 50, "imitation": IMITATION}
    with pytest.raises(ValueError, match=message):
        RunConfig(**given | {"feedback": FeedbackConfig(segment=10)} | fields)


def test_names_in_tables(imitating):
    """What the run that trains a prior is called, and the baseline."""
    assert imitating().method == "airl"
    assert imitating("finetune").method == "finetune"


def test_settings_of_others_change_no_identity(tiny):
    """To runs that do not begin with demonstrations the section means nothing, nor densities to a squared error."""
    assert tiny(imitation=IMITATION).identity == tiny().identity
    plain = IMITATION.model_copy(update={"uniform": 0.0})
    assert tiny("airl", imitation=plain).identity != tiny("airl", imitation=IMITATION).identity
    squared = [each.model_copy(update={"pretrain": "mse"}) for each in (plain, IMITATION)]
    assert len({tiny("airl", imitation=each).identity for each in squared}) == 1
    with pytest.raises(ConfigError, match="cannot read"):
        RunConfig(
            task="toy-car", seed=0, steps=9000, reward=RewardConfig(learner="airl"),
            imitation=ImitationConfig(demos="/nowhere.safetensors"),
        ).canonical()  # fmt: skip


@pytest.mark.sim
def test_a_task_without_success_is_judged_by_its_return(recorder, tmp_path):
    """On DM-Control no demonstration can fail, and the best evaluation is the one of the highest return."""
    small = {"agent": SacConfig(hidden=16, layers=1, batch=16), "evaluation": EvaluationConfig(every=60, episodes=1)}
    common = {"task": "walker-walk", "seed": 0, "horizon": 20, "steps": 120, **small}
    expert = RunConfig(
        reward=RewardConfig(learner="true"), exploration=ExplorationConfig(seed_steps=40), **common
    ).canonical()
    demos = DemosConfig(task="walker-walk", expert=expert, episodes=2, least_success=1.0)
    imitation = IMITATION.model_copy(update={"seed_steps": 40, "every": 20, "demos_run": demos.identity})
    airl = RunConfig(reward=RewardConfig(learner="airl"), imitation=imitation, **common).canonical()
    folders = {config.identity: tmp_path / config.method for config in (expert, demos, airl)}
    told = recorder()
    for config in (expert, demos, airl):
        folders[config.identity].mkdir()
        assert perform(config, folders[config.identity], told, folders)
    kept = decode((folders[airl.identity] / "model.safetensors").read_bytes())["imitation"]
    assert kept["success"] is None
    assert kept["true_return"] == max(row.true_return for row in told.rows.values())
    assert any("2 episodes, mean return" in note for note in told.notes)
