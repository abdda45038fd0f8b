"""Which candidate is kept: those that execute, and among them the one that agrees most with the others."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import kendalltau

from rrm.envs import make, task
from rrm.errors import ConfigError, PriorError
from rrm.priors import load_prior
from rrm.priors.language import Candidate
from rrm.priors.language.candidates import (
    agreement,
    best,
    freeze_best,
    segment_sums,
    try_out,
    values,
    walk,
)
from rrm.priors.language.translate import admit
from rrm.priors.step import PriorStep, Scene
from tests.rrm.priors.language.steps import code, recorded, sha256

TOY = task("toy-car")
ORIGIN = {"model": "M", "date": "2026-01-02", "prompt": "Please."}

ANSWERS = {
    "distance.py": "return -np.linalg.norm(step.object - step.goal)",
    "exponential.py": "return np.exp(-np.linalg.norm(step.object - step.goal))",
    "squared.py": "return -np.sum(np.square(step.object - step.goal)) - 0.1 * np.sum(np.square(step.act))",
    "noise.py": "return np.sin(1000 * step.obs[0])",
    "constant.py": "return 1.0",
    "file.py": "return open('x')",
    "late.py": "if step.clearance < 0.3:\n    return 1 / 0\nreturn step.clearance",
    "infinite.py": "return np.exp(1000 * step.clearance)",
    "hidden.py": "return step.upright",
}


@pytest.fixture(scope="module")
def lived():
    return walk(TOY)


def written(folder, *names):
    for name in names:
        (folder / name).write_bytes(code(ANSWERS[name]))
    return [folder / name for name in names]


def judged(folder, lived, *names):
    paths = written(folder, *names)
    return try_out(TOY, {path.name: path.read_bytes() for path in paths}, lived)


def test_the_walk(lived):
    """Full episodes, always the same, one kind of action after the other, and no reward in them."""
    again = walk(TOY)
    for name in ("obs", "act", "outcomes"):
        np.testing.assert_array_equal(getattr(lived, name), getattr(again, name))
    assert lived.obs.shape == (4, 100, 15)
    assert len(np.unique(lived.act[0], axis=0)) == 100
    assert len(np.unique(lived.act[1], axis=0)) == 4
    assert set(lived._fields) == {"obs", "act", "outcomes"}


def test_the_walk_is_the_environments():
    """Observations follow from the actions as in the environment, and so do outcomes."""
    spec = task("walker-walk")
    lived, env = walk(spec), make("walker-walk")
    env.reset(seed=0)
    assert lived.outcomes.shape == (4, 1000, 3)
    np.testing.assert_allclose(lived.outcomes[:, :-1, 0], lived.obs[:, 1:, 0], atol=1e-6)  # uprightness, a step later
    env.close()


def test_values_are_those_of_a_run(tmp_path, lived):
    """A candidate is asked what the frozen prior is asked in training, for every step."""
    path = written(tmp_path, "squared.py")[0]
    said = values(admit(path.read_bytes(), path.name).function(), TOY, lived, path.name)
    target, _ = freeze_best(TOY, [path], tmp_path, **ORIGIN)
    prior = load_prior(f"{target}:reward")
    first = Scene(TOY, lived.obs[2, 0])
    step = PriorStep(TOY, lived.obs[2, 17], lived.act[2, 17], {}, np.random.default_rng(0), first)
    assert said.shape == (4, 100)
    assert said[2, 17] == prior(step)


def test_the_one_most_agreed_with_is_kept(tmp_path, lived):
    """Three that say nearly the same outvote a fourth that does not."""
    candidates = judged(tmp_path, lived, "noise.py", "distance.py", "exponential.py", "squared.py")
    scores = [candidate.score for candidate in candidates]
    assert best(candidates) in (1, 2, 3)
    assert scores[0] == min(scores) < 0.65
    assert scores[0] + 0.1 < scores[1]


def test_what_does_not_execute(tmp_path, lived):
    """Refused code, features that are not there, a failure at one step, what is not finite, and what never varies."""
    names = ["file.py", "hidden.py", "late.py", "infinite.py", "constant.py", "distance.py"]
    said = [c.refused for c in judged(tmp_path, lived, *names)]
    for reason, expected in zip(
        said, ("line 6: `open`", "reads upright", "at step", "finite", "says 1 of every step"), strict=False
    ):
        assert expected in reason
    assert said[-1] is None


def test_one_left_needs_no_score(tmp_path, lived):
    """With nothing to agree with there is no score, and it is kept."""
    candidates = judged(tmp_path, lived, "constant.py", "distance.py")
    assert [candidate.score for candidate in candidates] == [None, None]
    assert best(candidates) == 1


def test_best():
    """The highest score, the first of equals, nothing of what was refused."""

    def candidates(*scores):
        return [Candidate(file="x", sha256="", score=s, refused=None if s is not None else "no") for s in scores]

    assert best(candidates(0.5, 0.9, 0.9, None)) == 1
    assert best(candidates(None, None)) is None


def test_the_true_reward_has_no_say(tmp_path, monkeypatch):
    """With another true reward everything comes out the same."""
    paths = written(tmp_path, "distance.py", "noise.py", "squared.py")
    before = freeze_best(TOY, paths, tmp_path / "a", **ORIGIN)[0].read_bytes()
    monkeypatch.setattr("rrm.envs.toy_car.true_reward", lambda *_: float("nan"))
    assert freeze_best(TOY, paths, tmp_path / "b", **ORIGIN)[0].read_bytes() == before


def test_segments():
    """Sums over 50 steps inside an episode, begun every 10."""
    said = np.arange(200, dtype=np.float64).reshape(2, 100)
    sums = segment_sums(said)
    assert sums.tolist() == [float(said[e, t : t + 50].sum()) for e in (0, 1) for t in (0, 10, 20, 30, 40, 50)]


distinct = st.lists(st.integers(-1000, 1000), min_size=5, max_size=20, unique=True)


@given(distinct, st.randoms())
def test_agreement_is_kendalls(xs, random):
    """Without ties it is Kendall's tau, brought from [-1, 1] to [0, 1]: order alone counts, and turned it is 1 - x."""
    first, second = np.array(xs, float), np.array(random.sample(xs, len(xs)), float)
    assert agreement(first, second) == pytest.approx((kendalltau(first, second).statistic + 1) / 2)
    assert agreement(first, first) == 1.0
    assert agreement(first, 3 * second + 1) == pytest.approx(agreement(second, first))
    assert agreement(first, -second) == pytest.approx(1 - agreement(first, second))


def test_ties_count_half():
    """A pair that one of them calls equal is worth half an agreement."""
    assert agreement(np.array([1.0, 2.0, 2.0]), np.array([1.0, 2.0, 3.0])) == pytest.approx(2.5 / 3)


def test_add(tmp_path):
    """The best is frozen whole, with the digests of its prompt and of every candidate, and never overwritten."""
    paths = written(tmp_path, "file.py", "distance.py", "exponential.py")
    target, record = freeze_best(TOY, paths, tmp_path / "new" / "priors", **ORIGIN)
    assert target == tmp_path / "new" / "priors" / "toy-car.language.py"
    assert target.read_bytes().endswith(paths[1].read_bytes())
    assert recorded(target) == record
    assert (record.task, record.model, record.date, record.kept) == ("toy-car", "M", "2026-01-02", "distance.py")
    assert record.prompt_sha256 == sha256(b"Please.")
    assert [c.sha256 for c in record.candidates] == [sha256(path.read_bytes()) for path in paths]
    with pytest.raises(ConfigError, match=r"toy-car\.language\.py is frozen"):
        freeze_best(TOY, paths, tmp_path / "new" / "priors", **ORIGIN)


def test_nothing_to_add(tmp_path):
    """Every candidate's reason is told, and nothing is written."""
    paths = written(tmp_path, "file.py", "constant.py")
    with pytest.raises(PriorError, match=r"(?s)no candidate can be used:.*file\.py, line 6.*constant\.py: says 1"):
        freeze_best(TOY, paths, tmp_path / "priors", **ORIGIN)
    assert not (tmp_path / "priors").exists()


@pytest.mark.parametrize(
    ("names", "origin", "said"),
    [
        (["distance.py"], ORIGIN | {"model": "M\n# ///"}, "cannot stand in a record"),
        (["distance.py"], ORIGIN | {"model": ""}, "cannot stand in a record"),
        (["none.py"], ORIGIN, r"cannot read .*none\.py"),
        (["distance.py", "other/distance.py"], ORIGIN, "two candidates have the same file name"),
    ],
)
def test_bad_input(tmp_path, names, origin, said):
    """Said before anything is tried."""
    written(tmp_path, "distance.py")
    with pytest.raises(ConfigError, match=said):
        freeze_best(TOY, [tmp_path / name for name in names], tmp_path, **origin)


def test_what_is_too_slow_is_refused(lived):
    """Between two steps the clock is looked at: nobody could train with it."""
    with pytest.raises(PriorError, match=r"mine\.py: too slow, 1 steps took more than 0 s"):
        values(lambda step: 0.0, TOY, lived, "mine.py", seconds=0)
