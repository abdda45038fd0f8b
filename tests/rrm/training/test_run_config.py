"""A run's configuration and its identity."""

import re
from dataclasses import fields as fields_of

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from rrm.config import (
    CameraConfig,
    DrmConfig,
    DrqConfig,
    EnvConfig,
    EvaluationConfig,
    ExplorationConfig,
    FeedbackConfig,
    ImitationConfig,
    MrnConfig,
    RewardConfig,
    SacConfig,
    SurfConfig,
    TeacherConfig,
)
from rrm.envs.panda.physics import Physics
from rrm.errors import RrmError
from rrm.training.run_config import RunConfig


def run(**fields):
    return RunConfig(**{"task": "button-press", "seed": 0, "steps": 500_000} | fields)


def test_the_defaults_are_the_papers():
    """Tables of the appendix: SAC, RRM."""
    config = run()
    agent, reward, feedback = config.agent, config.reward, config.feedback
    assert (agent.hidden, agent.layers, agent.batch, agent.actor_lr, agent.critic_lr) == (256, 3, 512, 1e-4, 1e-4)
    assert (agent.discount, agent.tau, agent.target_every, agent.initial_alpha) == (0.99, 0.005, 2, 0.1)
    assert (reward.members, reward.hidden, reward.layers, reward.lr, reward.capacity) == (3, 256, 3, 3e-4, 10_000)
    assert (feedback.batch, feedback.every, feedback.segment, feedback.budget) == (50, 5000, 50, 5000)


OTHER = {int: lambda v: v + 1, float: lambda v: v * 0.5 if v else 0.25, str: None, bool: None}
#: Values that are not reached by arithmetic, or that need a partner to mean anything.
SPECIAL = {
    "agent": {"kind": None, "critic_norm": "layer"}, "evaluation": {"success": "last"},
    "teacher": {"beta": 1.0, "kind": "human", "study": None, "labels": None},
    "reward": {"learner": "true", "prior": "proxy", "normaliser": None, "surf": None, "mrn": None,
               "bound": None, "penalty": None, "inputs": "standard", "prior_run": None, "squash": None,
               "most_steps": 50, "factor": None},
    "feedback": {"sampler": "uniform", "schedule": "decay"}, "exploration": {"neighbours": None},
}  # fmt: skip
NOT_NUMBERS = {"options", "prior_digest", "learner_digest", "labels_digest", "deterministic"}


def every_change():
    """Each field of each section with another value, one at a time."""
    base = run()
    for section, specials in SPECIAL.items():
        part = getattr(base, section)
        for field in type(part).model_fields:
            special = specials.get(field, ...)
            if field in NOT_NUMBERS or special is None:
                continue
            value = getattr(part, field)
            other = OTHER[type(value)](value) if special is ... else special
            yield f"{section}.{field}", run(**{section: part.model_copy(update={field: other})})
    yield from ((f"{k}={v}", run(**{k: v})) for k, v in {
        "seed": 1, "steps": 400_000, "task": "door-open", "horizon": 250, "threads": 2, "profile": "laptop",
    }.items())  # fmt: skip


def test_anything_that_can_change_numbers_changes_the_identity():
    """Every field of every section, each on its own, makes another run."""
    changed = dict(every_change())
    assert len(changed) > 40
    identities = {name: config.identity for name, config in changed.items()} | {"base": run().identity}
    assert len(set(identities.values())) == len(identities), identities


ENV = {"cube_size": 0.06, "cube_mass": [0.1, 0.3], "friction": 1, "latency": [0, 2], "noise": 0.001}


def on_the_arm(**env):
    return RunConfig.model_validate({"task": "panda-push", "seed": 0, "steps": 100_000, "env": env})


def test_domain_randomisation():
    """Whatever varies makes another run; what is as the task has it anyway does not, nor one number for a range."""
    changed = [on_the_arm(), *(on_the_arm(**{name: value}) for name, value in ENV.items()), on_the_arm(**ENV)]
    assert len({config.identity for config in changed}) == len(ENV) + 2
    usual = RunConfig(task="panda-push", seed=0, steps=100_000)
    assert on_the_arm(cube_mass=0.1, latency=0).identity == usual.identity
    assert on_the_arm(cube_mass=[0.1, 0.2]).env.ranges() == {"cube_mass": (0.1, 0.2)}
    assert on_the_arm(friction=1).identity == on_the_arm(friction=[1.0, 1.0]).identity
    assert RunConfig.model_validate(changed[-1].model_dump(mode="json")) == changed[-1]


def test_every_quantity_that_may_vary_is_the_simulation_s():
    """Settings and physics have one name for each."""
    assert set(EnvConfig.model_fields) == set(ENV) <= {field.name for field in fields_of(Physics)}


@pytest.mark.parametrize(
    ("env", "reason"),
    [
        ({"cube_mass": -1}, "greater than or equal to 0.01"),
        ({"cube_mass": [0.2, 0.1]}, "from its lower to its upper end"),
        ({"cube_mass": [0.1, 0.2, 0.3]}, r"One number, or a range \[lowest, highest\]"),
        ({"friction": "smooth"}, r"One number, or a range \[lowest, highest\]"),
        ({"latency": 0.5}, "valid integer"),
        ({"noise": float("nan")}, "finite number"),
    ],
)
def test_ranges_that_are_none(env, reason):
    """The message says what a range is."""
    with pytest.raises(ValidationError, match=reason):
        on_the_arm(**env)


def on_images(**fields):
    given = {
        "task": "button-press-image", "seed": 0, "steps": 100_000, "action_repeat": 2, "agent": DrmConfig(kind="drm"),
        "exploration": ExplorationConfig(seed_steps=4000),
    }  # fmt: skip
    return RunConfig(**given | fields)


def test_likewise_on_images():
    """Whatever an agent on images is told, and how its task is looked at, makes another run."""
    agents = {"strides": (2, 1), "encoder": "imitation", "encoder_run": "0" * 16}
    cameras = {"view": "corner", "size": 48, "stack": 2, "quality": "full"}
    agent, kept = DrmConfig(kind="drm"), {"kind"}
    other_kind = on_images(agent=DrqConfig(kind="drqv2"))
    changed = {"itself": on_images(), "action_repeat": on_images(action_repeat=1), "kind": other_kind}
    for field in DrmConfig.model_fields.keys() - kept:
        value = getattr(agent, field)
        other = agents[field] if field in agents else OTHER[type(value)](value)
        changed[field] = on_images(agent=agent.model_copy(update={field: other}))
    changed |= {field: on_images(camera=CameraConfig(**{field: value})) for field, value in cameras.items()}
    assert len({config.identity for config in changed.values()}) == len(changed) > 25


def test_what_is_said_of_a_camera_that_is_so_anyway():
    """Named or not, the task's own view is the same run; a run that sees no frames has no camera."""
    own = CameraConfig(view="corner4", size=64, stack=3, quality="fast")
    assert on_images(camera=own).identity == on_images().identity
    blind = on_images(agent=SacConfig())
    assert blind.spaces.frames is None
    assert on_images(agent=SacConfig(), camera=CameraConfig(size=48)).identity == blind.identity


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"task": "button-press"}, "sees frames, button-press has none"),
        ({"steps": 100_001}, "steps: 100001 is not a multiple of action_repeat, 2"),
        ({"feedback": FeedbackConfig(segment=25)}, "feedback.segment: 25 is not a multiple"),
        ({"evaluation": EvaluationConfig(every=5001)}, "evaluation.every: 5001 is not a multiple"),
        ({"reward": RewardConfig(learner="mrn")}, "mrn does not learn from frames"),
        ({"exploration": ExplorationConfig(unsupervised_steps=2000)}, "state entropy is not that of frames"),
        ({"camera": CameraConfig(view="cornr")}, 'did you mean "corner'),
    ],
)  # fmt: skip
def test_what_does_not_go_with_frames_is_refused(changes, told):
    with pytest.raises(ValidationError, match=re.escape(told)):
        on_images(**changes)


def test_an_encoder_is_borrowed_on_the_prior_it_belongs_to():
    """Without a word it is that of the prior `imitation`, where the agent stands on that; both ways it can be told."""

    def borrows(prior, encoder):
        return on_images(reward=RewardConfig(prior=prior), agent=DrqConfig(kind="drqv2", encoder=encoder))

    own = [("penalty", None), ("penalty", "fresh"), ("imitation", "fresh")]
    lent = [("imitation", None), ("imitation", "imitation"), ("penalty", "imitation")]
    assert not any(borrows(*given).borrows_encoder for given in own)
    assert all(borrows(*given).borrows_encoder for given in lent)
    assert borrows("imitation", None).identity == borrows("imitation", "imitation").identity
    assert borrows("penalty", None).identity == borrows("penalty", "fresh").identity


def test_what_cannot_change_numbers_does_not():
    """Teacher and feedback mean nothing to the oracle, nor does the task's own horizon said aloud."""
    oracle = {"reward": RewardConfig(learner="true")}
    assert run(**oracle).identity == run(**oracle, teacher=TeacherConfig(mistake=0.1)).identity
    assert run(**oracle).identity == run(reward=RewardConfig(learner="true", hidden=64, prior="proxy")).identity
    assert run().identity == run(horizon=500).identity
    assert run().identity == run(reward=RewardConfig(normaliser="zscore")).identity
    assert run().identity == run(exploration=ExplorationConfig(neighbours=7)).identity
    uniform = [run(feedback=FeedbackConfig(sampler="uniform", pool=pool)).identity for pool in (10, 20)]
    assert uniform[0] == uniform[1]
    walker = {"task": "walker-walk", "reward": RewardConfig(prior="proxy")}
    late = ExplorationConfig(seed_steps=2000)
    assert run(**walker).identity == run(**walker, exploration=late).identity


def learned(learner, **fields):
    return run(reward=RewardConfig(learner=learner, **fields)).identity


def test_settings_of_a_learner_count_for_it_alone():
    """Each of SURF's and MRN's settings makes another run of that learner, and changes nothing for the others."""
    others = {
        "surf": {"threshold": 0.95, "ratio": 1, "unlabelled": 100, "weight": 0.5, "margin": 6, "crop": 4},
        "mrn": {"every": 5000, "outer_weight": 0.2, "meta_optimizer": "separate", "faithful_done": True},
    }
    for name, section in (("surf", SurfConfig), ("mrn", MrnConfig)):
        assert set(others[name]) == set(section.model_fields)
        changed = [{name: section(**{field: value})} for field, value in others[name].items()]
        assert len({learned(name), *(learned(name, **fields) for fields in changed)}) == len(changed) + 1
        for other in {"pebble", "surf", "mrn", "true"} - {name}:
            assert {learned(other)} == {learned(other, **fields) for fields in changed}
    assert learned("surf") == learned("surf", target_accuracy=0.5)  # it never stops early


def test_the_squared_penalty_counts_where_there_is_a_prior():
    """The bound and its weight are another run of a residual model; a reward without a prior has nothing to be near."""
    gaussian = {"bound": "gaussian", "prior": "proxy"}
    assert len({learned("surf", **fields) for fields in (
        {"prior": "proxy"}, gaussian, gaussian | {"penalty": 0.5},
    )}) == 3  # fmt: skip
    assert learned("surf", prior="proxy") == learned("surf", prior="proxy", penalty=0.5)
    assert learned("surf") == learned("surf", bound="gaussian", penalty=0.5)


def test_a_users_learner_may_be_told_anything(tmp_path):
    """Sections of our learners stay where a file decides what it reads: it may build on one of them."""
    (tmp_path / "mine.py").write_text("class Mine: ...")
    mine = f"{tmp_path}/mine.py:Mine"
    assert learned(mine) != learned(mine, surf=SurfConfig(margin=7))
    assert learned(mine) != learned(mine, mrn=MrnConfig(every=7))


def test_identities_are_stable():
    """These digests must never change: results on disk are known by them. A change of numbers raises CONFIG_VERSION."""
    assert run().identity == "73241a693b7e8edb"
    assert run(reward=RewardConfig(prior="proxy"), seed=3).identity == "5136ce186e19089a"


@pytest.mark.parametrize(
    ("learner", "before", "now"),
    [("airl", "26010b0fb451471e", "3bdd934529e06a06"), ("finetune", "742dcf414892bf43", "4ff7f2a8e9f13269")],
)
def test_runs_from_demonstrations_have_a_version_of_their_own(learner, before, now):
    """A default of theirs gave other numbers once: the identity of that time stands for other results."""
    identity = run(reward=RewardConfig(learner=learner), imitation=ImitationConfig(demos_run="0" * 16)).identity
    assert before != identity == now


def test_a_cell_is_the_run_without_its_seed():
    """Seeds of one setting share the cell, and nothing else does."""
    assert run(seed=1).cell == run(seed=2).cell
    assert run(seed=1).cell != run(seed=1, steps=400_000).cell


def test_a_users_file_counts_by_its_content(tmp_path):
    """The same function has one identity wherever it lies; an edited one has another."""
    text = "def mine(step):\n    return 0.0\n"
    identities = []
    for folder, content in (("a", text), ("b", text), ("c", text + "\n# edited\n")):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "prior.py").write_text(content)
        config = run(reward=RewardConfig(prior=f"{tmp_path}/{folder}/prior.py:mine"))
        assert config.method == "rrm-mine"
        identities.append(config.identity)
    assert identities[0] == identities[1] != identities[2]


@pytest.mark.parametrize(
    ("fields", "method"),
    [
        ({}, "pebble"),
        ({"reward": RewardConfig(learner="true")}, "oracle"),
        ({"reward": RewardConfig(prior="proxy")}, "rrm-proxy"),
        ({"reward": RewardConfig(learner="prior", prior="h2o")}, "sac-h2o"),
        ({"reward": RewardConfig(learner="surf")}, "surf"),
        ({"reward": RewardConfig(learner="surf", prior="proxy")}, "rrm-surf-proxy"),
        ({"reward": RewardConfig(learner="mrn", prior="proxy")}, "rrm-mrn-proxy"),
    ],
)
def test_methods_are_named_as_in_the_tables(fields, method):
    """The name follows from learner and prior."""
    assert run(**fields).method == method


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"task": "button-pres"}, 'did you mean "button-press"'),
        ({"reward": RewardConfig(learner="peble")}, 'unknown learner "peble"; did you mean "pebble"'),
        ({"reward": RewardConfig(prior="proxi")}, 'unknown prior "proxi"; did you mean "proxy"'),
        ({"reward": RewardConfig(learner="prior")}, "needs one named"),
        ({"task": "walker-walk", "reward": RewardConfig(prior="h2o")}, "does not reveal"),
        (
            {"env": EnvConfig(friction=(0.5, 0.6))},
            r"env\.friction: button-press .* these have: panda-reach, panda-push",
        ),
        ({"feedback": FeedbackConfig(segment=501)}, "do not fit into an episode of 500"),
        ({"steps": 1000}, "the run ends at 1000, before the first feedback at 1000"),
        ({"horizon": 501}, "longer than button-press's episode of 500"),
        ({"feedback": None}, "needs both"),
        ({"steps": 1000, "reward": RewardConfig(learner="true")}, "before the first update"),
        ({"reward": RewardConfig(options={"a": 1})}, "takes none"),
        (
            {"horizon": 59, "reward": RewardConfig(learner="surf")},
            "feedback.segment: 50 steps and 5 more on either side do not fit into an episode of 59",
        ),
        (
            {"reward": RewardConfig(learner="surf", surf=SurfConfig(crop=11))},
            "reward.surf.crop: 11 steps more or less; 10 at the most with segments of 50 between margins of 5",
        ),
        (
            {"feedback": FeedbackConfig(segment=5), "reward": RewardConfig(learner="surf")},
            "reward.surf.crop: 5 steps more or less; 4 at the most",
        ),
        (
            {"agent": SacConfig(update_every=3), "reward": RewardConfig(learner="mrn")},
            "reward.mrn.every: 10000 is not a multiple of agent.update_every, 3",
        ),
    ],
)
def test_what_cannot_be_run_is_refused(fields, message):
    """The message names the key and what would do."""
    with pytest.raises((RrmError, ValidationError), match=message):
        run(**fields)


@pytest.mark.parametrize(
    "fields", [{"stpes": 1}, {"agent": {"hiden": 1}}, {"steps": 0}, {"seed": -1}, {"steps": "600000"}, {"seed": True}]
)
def test_unknown_keys_and_wrong_types_are_refused(fields):
    """Nothing is ignored and nothing is coerced into sense."""
    with pytest.raises(ValidationError):
        run(**fields)


def test_feedback_waits_for_two_episodes():
    """On DM-Control a thousand steps are one episode: random actions and the first session move to 2000."""
    residual = run(task="walker-walk", reward=RewardConfig(prior="proxy"))
    assert (residual.random_steps, residual.first_session) == (2000, 2000)
    baseline = run(task="walker-walk", exploration=ExplorationConfig(unsupervised_steps=9000))
    assert (baseline.random_steps, baseline.first_session) == (1000, 10_000)


@given(st.integers(1500, 100_000), st.integers(1, 9000), st.integers(1, 60), st.integers(1, 5000))
def test_sessions_are_those_the_loop_holds(steps, every, batch, budget):
    """As many as a walk over the steps counts, each asking its batch until the budget is spent."""
    config = run(steps=steps, feedback=FeedbackConfig(every=every, batch=batch, budget=budget))
    asked = sessions = 0
    for _ in range(config.first_session, steps, every):
        if asked >= budget:
            break
        asked += min(batch, budget - asked)
        sessions += 1
    assert config.sessions() == sessions
    assert config.queries() == asked
