"""The training loop: what happens at which step."""

import numpy as np
import pytest
import torch

from rrm.buffers.replay import Replay
from rrm.config import MrnConfig, SurfConfig
from rrm.errors import ConfigError, NumericalError, PriorError
from rrm.interfaces import Needs
from rrm.training.loop import Trainer


@pytest.fixture
def traced(tiny, monkeypatch):
    """Runs a configuration and records, per step, what was done."""

    def run(steps, **fields):
        trainer = Trainer(tiny(**fields))
        log = []
        update, reset = trainer.agent.update, trainer.agent.reset_critic

        def traced_update(batch):
            known = trainer.experience.transitions
            assert known == trainer.step, "the update must not see the transition of its own step"
            log.append((trainer.step, "update"))
            update(batch)

        def traced_reset():
            log.append((trainer.step, "reset"))
            reset()

        monkeypatch.setattr(trainer.agent, "update", traced_update)
        monkeypatch.setattr(trainer.agent, "reset_critic", traced_reset)
        if "preferences" in trainer.sources:
            ask, scaled = trainer.sources["preferences"].teacher.ask, trainer.sources["entropy"].scaled
            monkeypatch.setattr(
                trainer.sources["preferences"].teacher, "ask",
                lambda queries: (log.append((trainer.step, "session")), ask(queries)),
            )  # fmt: skip
            monkeypatch.setattr(
                trainer.sources["entropy"], "scaled",
                lambda distance: (log.append((trainer.step, "entropy")), scaled(distance))[1],
            )  # fmt: skip
        for _ in range(steps):
            trainer.advance()
        trainer.close()
        return trainer, log

    return run


def when(log, what):
    return [step for step, done in log if done == what]


def test_pebbles_schedule_is_b_prefs(traced):
    """Random steps, unsupervised updates, one session with reset and extra updates, then an update at every step."""
    trainer, log = traced(480)
    assert when(log, "entropy") == list(range(101, 150))
    assert when(log, "session") == [150, 300, 450]
    assert when(log, "reset") == [150]
    updates = when(log, "update")
    assert updates.count(150) == 5
    assert sorted(set(updates)) == list(range(101, 480))
    assert [trainer.sources["preferences"].queries, trainer.sources["preferences"].labels] == [25, 25]


def test_the_budget_ends_the_sessions(traced):
    """The last session asks for what is left; none comes after it."""
    trainer, log = traced(620)
    assert when(log, "session") == [150, 300, 450]
    assert trainer.sources["preferences"].queries == 25


def test_the_oracle_updates_after_its_random_steps(traced):
    """No session, no reset; the first update is at the step after the random ones."""
    _, log = traced(110, learner="true")
    assert log == [(step, "update") for step in range(101, 110)]


def test_updates_can_be_spread(traced, tiny):
    """With `update_every` n only each n-th step updates."""
    agent = tiny().agent.model_copy(update={"update_every": 3})
    _, log = traced(120, learner="true", agent=agent)
    assert when(log, "update") == [102, 105, 108, 111, 114, 117]


def test_early_updates_are_two(traced, tiny):
    """Before `early_steps` the agent is updated twice where it would be once."""
    agent = tiny().agent.model_copy(update={"early_steps": 103})
    _, log = traced(105, learner="true", agent=agent)
    assert when(log, "update") == [101, 101, 102, 102, 103, 104]


def test_the_oracle_is_trained_on_the_true_reward(traced):
    """The reward column is the true one for the oracle, and the prior for prior-only training."""
    trainer, _ = traced(60, learner="true")
    rows = trainer.experience.since(0)
    assert torch.equal(trainer.experience.true_reward[rows], trainer.experience.reward[rows])
    trainer, _ = traced(60, learner="prior", prior="proxy")
    assert torch.equal(trainer.experience.prior[rows], trainer.experience.reward[rows])
    assert not torch.equal(trainer.experience.true_reward[rows], trainer.experience.reward[rows])


def test_stored_rewards_are_what_the_reward_says_now(traced):
    """After sessions and steps, every stored reward is the current ensemble's of the stored prior."""
    trainer, _ = traced(333, prior="proxy")
    experience = trainer.experience
    rows = experience.since(0)
    predicted = trainer.sources["preferences"].learner.reward.predict(
        experience.obs[rows], experience.act[rows], experience.prior[rows]
    )
    torch.testing.assert_close(predicted, experience.reward[rows], atol=1e-6, rtol=0)


def test_the_prior_is_of_the_state_before_the_step(traced):
    """Proxy of s_t on the car: minus the distance from where it stood to the goal."""
    trainer, _ = traced(60, prior="proxy")
    rows = trainer.experience.since(0)
    obs = trainer.experience.obs[rows]
    distance = (obs[:, 0:2] - obs[:, 2:4]).norm(dim=1)
    torch.testing.assert_close(-distance, trainer.experience.raw_prior[rows])


def test_evaluation_does_not_disturb_training(tiny):
    """However often one evaluates, the training that follows is the same bit for bit."""
    trainers = [Trainer(tiny(prior="random")) for _ in range(2)]
    for step in range(330):
        for trainer in trainers:
            trainer.advance()
        if step % 40 == 0:
            trainers[0].evaluate()
    rows = trainers[0].experience.since(0)
    for column in ("obs", "act", "reward", "prior"):
        assert torch.equal(*(getattr(t.experience, column)[rows] for t in trainers))
    assert torch.equal(*(t.agent.actor.flat for t in trainers))
    assert len({t.evaluate().true_return for t in trainers}) == 1


def test_two_seeds_differ_and_one_repeats(tiny):
    """The seed decides everything."""
    seen = []
    for seed in (0, 0, 1):
        trainer = Trainer(tiny(seed=seed))
        for _ in range(200):
            trainer.advance()
        seen.append(trainer.experience.obs[trainer.experience.since(0)])
    assert torch.equal(seen[0], seen[1])
    assert not torch.equal(seen[0], seen[2])


def test_a_row_says_what_was_lived(traced):
    """Means are over the transitions since the last row; prior and residual add up to the reward."""
    trainer, _ = traced(200, prior="proxy")
    row = trainer.evaluate()
    assert row.prior_mean + row.residual_mean == pytest.approx(row.reward_mean)
    assert (row.step, row.episodes, row.queries, row.labels) == (200, 2, 10, 10)
    for _ in range(50):
        trainer.advance()
    later = trainer.evaluate()
    rows = trainer.experience.since(200)
    assert later.true_reward_mean == pytest.approx(float(trainer.experience.true_reward[rows].double().mean()))


def test_a_failing_prior_names_itself_and_the_step(tiny, tmp_path):
    """A user's prior that raises at its thirtieth call stops the run with prior, step and cause."""
    file = tmp_path / "mine.py"
    file.write_text("n = 0\ndef bad(step):\n    global n\n    n += 1\n    return 1 / (30 - n)\n")
    trainer = Trainer(tiny(prior=f"{file}:bad"))
    for _ in range(29):
        trainer.advance()
    with pytest.raises(PriorError, match=r'prior ".*mine.py:bad" at step 29 raised ZeroDivisionError'):
        trainer.advance()


def test_a_reward_that_is_not_finite_stops_the_run(tiny, monkeypatch):
    """NaN from the simulator is an error that names the step, not something to learn from."""
    trainer = Trainer(tiny())
    step = trainer.env.step

    def broken(act):
        obs, _, *rest = step(act)
        return obs, np.nan, *rest

    monkeypatch.setattr(trainer.env, "step", broken)
    with pytest.raises(NumericalError, match="step 0: the true reward is nan"):
        trainer.advance()


def test_a_refined_reward_is_what_the_batch_is_trained_on(tiny, monkeypatch):
    """When the learner changes the reward before an update, buffer and batch carry the new one."""
    trainer = Trainer(tiny(prior="proxy"))
    for _ in range(200):
        trainer.advance()
    learner, seen = trainer.sources["preferences"].learner, []

    def refine(batch, agent, feedback):
        with torch.no_grad():
            for parameter in learner.reward.parameters():
                parameter.mul_(1.5)
        return True

    monkeypatch.setattr(learner, "refine", refine)
    monkeypatch.setattr(trainer.agent, "update", seen.append)
    trainer.advance()
    batch = seen[0]
    torch.testing.assert_close(learner.reward.predict(batch.obs, batch.act, batch.prior), batch.reward)


def test_a_prior_cannot_change_what_is_stored(tiny, tmp_path):
    """Writing to the observation or action it is shown is an error that names the prior."""
    file = tmp_path / "mine.py"
    file.write_text("def careless(step):\n    step.obs[0] += 1\n    return 0.0\n")
    trainer = Trainer(tiny(prior=f"{file}:careless"))
    with pytest.raises(PriorError, match=r"careless.*read-only"):
        trainer.advance()


def test_a_prior_beyond_float32_is_refused(tiny, tmp_path):
    """A number that cannot be stored names the prior and the step."""
    file = tmp_path / "mine.py"
    file.write_text("def huge(step):\n    return 1e39\n")
    with pytest.raises(PriorError, match=r"huge.* at step 0 returned 1e\+39"):
        Trainer(tiny(prior=f"{file}:huge")).advance()


def test_the_teacher_sees_the_middle_of_what_surf_sees(tiny, monkeypatch):
    """Segments are stored with their margins inside one episode; the true rewards told are those without."""
    trainer, asked = Trainer(tiny("surf", surf=SurfConfig(margin=7))), []
    teacher = trainer.sources["preferences"].teacher
    prefer = teacher.prefer
    monkeypatch.setattr(teacher, "prefer", lambda *rewards: (asked.append(rewards), prefer(*rewards))[1])
    for _ in range(320):
        trainer.advance()
    assert [rewards[0].shape for rewards in asked] == [(10, 10), (10, 10)]
    starts = trainer.sources["preferences"].preferences.pairs
    steps = starts[..., None] + 7 + np.arange(10)
    told = np.concatenate([np.stack(rewards, axis=1) for rewards in asked])
    np.testing.assert_array_equal(trainer.experience.true_reward.numpy()[steps], told)
    for pairs in (starts, trainer.sources["preferences"].unlabelled.pairs):
        assert ((pairs % 51) + 24 <= 50).all()  # 50 steps of an episode, and a row for its last observation
    first, _, _ = trainer.sources["preferences"].feedback.pairs(torch.arange(3))
    assert first.obs.shape == (3, 24, 15)


def test_pairs_without_a_label_are_drawn_for_every_query(tiny):
    """So many per query asked, kept all along, from a stream of their own: the queries stay what they were."""
    few, many = (Trainer(tiny("surf", surf=SurfConfig(unlabelled=n), sampler="uniform")) for n in (2, 9))
    for trainer in (few, many):
        for _ in range(151):
            trainer.advance()
    assert [len(t.sources["preferences"].unlabelled) for t in (few, many)] == [20, 90]
    np.testing.assert_array_equal(*(t.sources["preferences"].preferences.pairs for t in (few, many)))
    for _ in range(400):
        many.advance()
    assert len(many.sources["preferences"].unlabelled) == 9 * 25
    assert len(Trainer(tiny()).sources["preferences"].unlabelled) == 0


def refined(tiny, monkeypatch, steps, **fields):
    """At which steps MRN's reward is refined, and the batches it is given."""
    trainer, calls = Trainer(tiny("mrn", **fields)), []
    refine = trainer.sources["preferences"].learner.refine
    monkeypatch.setattr(
        trainer.sources["preferences"].learner, "refine",
        lambda batch, *rest: (calls.append((trainer.step, batch)), refine(batch, *rest))[1],
    )  # fmt: skip
    for _ in range(steps):
        trainer.advance()
    return trainer, calls


def test_mrn_refines_between_sessions_until_the_questions_are_spent(tiny, monkeypatch):
    """At multiples of `every` after the first session, a session first where both fall on one step, and no further."""
    _, calls = refined(tiny, monkeypatch, 620, mrn=MrnConfig(every=75))
    assert [step for step, _ in calls] == [225, 300, 375]  # sessions at 150, 300 and 450, where the budget ends
    assert all(batch.continues.min() == 1 for _, batch in calls)


def test_the_update_after_a_refinement_is_on_the_new_reward(tiny, monkeypatch):
    """Reward of the batch and of everything stored are what the reward says after its step on the outer loss."""
    trainer, _ = refined(tiny, monkeypatch, 225, mrn=MrnConfig(every=75), prior="proxy")
    learned = trainer.sources["preferences"].learner.reward
    seen, update, before = [], trainer.agent.update, learned.state_dict()["weights"]
    monkeypatch.setattr(trainer.agent, "update", lambda batch: (seen.append(batch), update(batch)))
    trainer.advance()
    assert not torch.equal(before, learned.state_dict()["weights"])
    torch.testing.assert_close(learned.predict(seen[0].obs, seen[0].act, seen[0].prior), seen[0].reward)
    rows, past = trainer.experience.since(0), trainer.experience
    torch.testing.assert_close(learned.predict(past.obs[rows], past.act[rows], past.prior[rows]), past.reward[rows])


def test_time_limits_end_an_episode_where_mrns_code_has_it_so(tiny, monkeypatch):
    """With `faithful_done` the batch of those steps stops at time limits, and that of every other step does not."""
    trainer, calls = refined(tiny, monkeypatch, 226, mrn=MrnConfig(every=75, faithful_done=True))
    generator = torch.Generator().manual_seed(0)
    whole, cut = (
        Replay(trainer.experience, 4000, generator.manual_seed(0)).sample(time_limits_end=end) for end in (False, True)
    )
    assert whole.continues.min() == 1
    assert (cut.continues == 0).float().mean() == pytest.approx(1 / 50, abs=0.01)
    assert torch.equal(whole.obs, cut.obs)
    trainer.sources["preferences"].learner.needs = Needs(refine_every=1, time_limits_end=True)
    while all(batch.continues.min() == 1 for _, batch in calls):
        trainer.advance()
        assert trainer.step < 320


def test_a_learners_margins_must_fit_into_an_episode(tiny, tmp_path):
    """A user's learner says what it needs when it is made; segments that cannot be drawn are refused then."""
    file = tmp_path / "mine.py"
    file.write_text(
        "from rrm.interfaces import Needs\nfrom rrm.rewards.pebble import Pebble\n"
        "class Wide(Pebble):\n    needs = Needs(margin=21)\n"
    )
    with pytest.raises(ConfigError, match="10 steps and 21 more on either side do not fit into an episode of 50"):
        Trainer(tiny(f"{file}:Wide"))
