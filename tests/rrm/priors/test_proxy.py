"""The priors of the paper on literal states, and what they refuse."""

import numpy as np
import pytest

from rrm.envs import TASKS, task
from rrm.errors import ConfigError, PriorError, RrmError, UnknownNameError
from rrm.priors import PRIORS, check_prior, load_prior
from rrm.priors.step import PriorStep, Scene


def state(name, **features):
    """An observation of the task with these features, every other number 0.5."""
    spec = task(name)
    obs = np.full(spec.spaces.obs, 0.5, np.float32)
    for feature, value in features.items():
        obs[spec.features[feature]] = value
    return obs


def step(name, *, success=0.0, seed=0, **features):
    spec, obs = task(name), state(name, **features)
    info = {"success": success} if spec.score == "success" else dict.fromkeys(spec.outcomes, 0.5)
    act = np.zeros(spec.spaces.act, np.float32)
    return PriorStep(spec, obs, act, info, np.random.default_rng(seed), Scene(spec, obs))


#: 3-4-5 triangles: the hand is 5 from the object, the object 10 from the goal.
ARM = {"hand": (0, 0, 1), "object": (3, 4, 1), "goal": (9, 4, 9)}


@pytest.mark.parametrize(
    ("prior", "expected"),
    [("proxy", -15), ("o2g", -10), ("h2o", -5), ("1d", -4), ("opposite", 15), ("zero", 0), ("sparse", 0)],
)
def test_arm(prior, expected):
    """Distances of hand, object and goal, in the paper's combinations."""
    assert load_prior(prior)(step("button-press", **ARM)) == pytest.approx(expected)


@pytest.mark.parametrize("prior", ["proxy", "o2g", "h2o"])
def test_arrived(prior):
    """A hand on an object at its goal is worth the most there is: 0."""
    assert load_prior(prior)(step("door-open", hand=(1, 2, 3), object=(1, 2, 3), goal=(1, 2, 3))) == 0


@pytest.mark.parametrize(("z", "expected"), [(1.0, 0.0), (0.0, -0.5), (-1.0, -1.0)])
@pytest.mark.parametrize("name", ["walker-walk", "quadruped-walk"])
def test_upright(name, z, expected):
    """(z - 1) / 2, and the opposite of it."""
    assert load_prior("proxy")(step(name, upright=z)) == expected
    assert load_prior("opposite")(step(name, upright=z)) == -expected


def test_upright_reads_the_observation_entry_of_the_suite():
    """Torso uprightness is entry 0 of the walker and 47 of the quadruped."""
    assert np.flatnonzero(state("walker-walk", upright=9.0) == 9).tolist() == [0]
    assert np.flatnonzero(state("quadruped-walk", upright=9.0) == 9).tolist() == [47]


@pytest.mark.parametrize("success", [0.0, 1.0])
def test_sparse(success):
    """The success flag of the step."""
    assert load_prior("sparse")(step("sweep-into", success=success)) == success


@pytest.mark.parametrize(
    ("clearance", "goal", "expected"),
    [
        (0.09, (2.0, 0.0), -1),
        (0.11, (2.0, 0.0), 0),
        (1.0, (0.45, 0.0), 10),
        (1.0, (0.3, 0.45), 0),
        (0.09, (0.2, 0.0), -1),
    ],
)
def test_toy(clearance, goal, expected):
    """The paper's toy prior: -1 near an obstacle, else 10 near the goal, whatever the step led to."""
    car = step("toy-car", object=(0.0, 0.0), goal=goal, clearance=clearance, success=1.0)
    assert load_prior("sparse")(car) == expected


def test_toy_proxy():
    """The car is hand and object in one, so its proxy is the distance to the goal."""
    assert load_prior("proxy")(step("toy-car", object=(0.0, 0.0), goal=(1.5, -2.0))) == pytest.approx(-2.5)


def test_random():
    """Uniform in (-1, 1) from the step's generator, whatever the state."""
    drawn = [load_prior("random")(step("walker-walk", seed=seed)) for seed in range(500)]
    assert drawn[:20] == [load_prior("random")(step("door-open", seed=seed)) for seed in range(20)]
    assert -1 < min(drawn) < -0.98
    assert 0.98 < max(drawn) < 1
    assert abs(np.mean(drawn)) < 0.1


@pytest.mark.parametrize("prior", [name for name in PRIORS if name not in ("random", "imitation")])
def test_pure(prior):
    """Asked twice, a prior says the same, and it leaves the observation as it was."""
    seen = step("button-press-image" if prior == "penalty" else "toy-car")
    before = seen.obs.copy()
    assert load_prior(prior)(seen) == load_prior(prior)(seen)
    np.testing.assert_array_equal(before, seen.obs)


def test_features_are_copies():
    """Writing into a feature does not reach the observation that will be stored."""
    seen = step("toy-car", goal=(1.0, 1.0))
    seen.goal[:] = 7
    assert seen.goal.tolist() == [1, 1]
    assert seen.goal.dtype == np.float64


@pytest.mark.parametrize(
    ("name", "feature", "revealed"),
    [
        ("walker-walk", "goal", "it reveals: upright"),
        ("walker-walk", "success", "it reveals: upright"),
        ("button-press", "upright", "it reveals: hand, object, goal, success"),
        ("button-press", "clearance", "it reveals: hand, object, goal, success"),
    ],
)
def test_hidden_features(name, feature, revealed):
    """Asking for what the task does not reveal names task, feature and what there is."""
    with pytest.raises(PriorError, match=f'{name} .*"{feature}".*{revealed}'):
        getattr(step(name), feature)


#: By suite the priors that ask for more than its tasks reveal.
UNSUITED = {
    "metaworld": {"penalty"},
    "dmc": {"o2g", "h2o", "1d", "sparse", "penalty"},
    "panda": {"penalty", "language"},
    "toy": {"penalty"},
    "metaworld-image": {"proxy", "opposite", "o2g", "h2o"},
    "toy-image": {"penalty", "language"},
}


@pytest.mark.parametrize("prior", [name for name in PRIORS if name != "imitation"])
@pytest.mark.parametrize("name", TASKS)
def test_planning_knows_what_will_run(prior, name):
    """`check_prior` refuses exactly the pairs of prior and task that would fail in the run."""
    spec = task(name)
    if prior in UNSUITED[spec.suite]:
        with pytest.raises(ConfigError):
            check_prior(prior, spec)
        with pytest.raises(RrmError):
            load_prior(prior)(step(name))
    else:
        check_prior(prior, spec)
        assert np.isfinite(load_prior(prior)(step(name)))


def test_refusal():
    """The message says what is read, what is revealed, and which priors would do."""
    with pytest.raises(
        ConfigError,
        match=r'prior "o2g" reads object, goal, which walker-walk does not reveal; it reveals: upright\. '
        r"Priors for walker-walk: imitation, language, opposite, proxy, random, zero",
    ):
        check_prior("o2g", task("walker-walk"))
    with pytest.raises(
        ConfigError, match=r'"proxy" reads hand, object, goal or upright, .* Priors for button-press-image: .*penalty'
    ):
        check_prior("proxy", task("button-press-image"))
    with pytest.raises(ConfigError, match='prior "sparse" reads success, which quadruped-walk does not reveal'):
        check_prior("sparse", task("quadruped-walk"))


def test_unknown():
    """The nearest name is suggested, before the run and in it."""
    for ask in (lambda: check_prior("proxi", task("toy-car")), lambda: load_prior("proxi")):
        with pytest.raises(UnknownNameError, match='unknown prior "proxi"; did you mean "proxy"'):
            ask()
