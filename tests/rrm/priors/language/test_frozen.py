"""The frozen functions that come with the library, and those of users."""

import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from pydantic import ValidationError

from rrm.config import RewardConfig
from rrm.envs import TASKS, make, task
from rrm.errors import ConfigError, PriorError
from rrm.priors import check_prior, load_prior
from rrm.priors.language import FROZEN, Candidate, Record, check_frozen, freeze, language, load_frozen
from rrm.priors.language.prompt import make_prompt
from rrm.priors.language.translate import admit
from rrm.priors.step import PriorStep, Scene
from rrm.training.run_config import RunConfig
from tests.rrm.priors.language.steps import code, random_step, recorded, sha256

every_task = pytest.mark.parametrize("name", sorted(language.tasks))

#: Tasks whose functions the paper prints.
PAPER = {"walker-walk", "button-press-image", "sweep-into-image"}


def shipped(name):
    return FROZEN / f"{name}.language.py"


def frozen(folder, body="return step.hand[0]", name="toy-car", file="mine.language.py"):
    """A frozen file of the user's, as `file:reward`."""
    source = code(body)
    record = Record(
        task=name, model="M", date="2026-01-02", prompt_sha256="0" * 64, kept="a.py",
        candidates=(
            Candidate(file="a.py", sha256=sha256(source), score=0.5), Candidate(file="b.py", sha256="1", refused='"no"')
        ),
    )  # fmt: skip
    (folder / file).write_bytes(freeze(record, source))
    return f"{folder / file}:reward", record


def test_tasks_that_have_one():
    """All but the one that exists for quick tests, and those of the arm, for which the paper has none."""
    assert {task(name).suite for name in set(TASKS) - language.tasks} == {"toy-image", "panda"}


@every_task
def test_what_is_said_of_it(name):
    """It passes the checker, reads what its task reveals, and its record says what it is."""
    check_frozen(f"{shipped(name)}:reward", task(name))
    check_prior("language", task(name))
    record = recorded(shipped(name))
    text = shipped(name).read_bytes()
    assert record.task == name
    assert record.candidates[0].sha256 == sha256(text[text.index(b"# ///\n\n") + 7 :])
    assert ("not the paper's" in record.note) == (name not in PAPER)
    assert record.model == ("GPT-5" if name in PAPER else "stand-in")


@every_task
def test_it_computes_what_python_computes(name):
    """To the last bit: being rebuilt and checked changes no value but that a float32 becomes a float earlier."""
    room: dict = {}
    source = shipped(name).read_bytes()
    exec(source, room)
    off = 1e-6 if admit(source, name).reads & {"obs", "act"} else 0.0
    prior, rng = load_prior("language"), np.random.default_rng(0)
    for _ in range(200):
        step = random_step(name, rng)
        assert float(prior(step)) == pytest.approx(float(room["reward"](step)), rel=off, abs=0.0)


@pytest.mark.sim
@every_task
def test_the_prompt_is_the_one_of_today(name):
    """The recorded prompt is what the installed simulator gives: another release would be another prompt."""
    prompt = make_prompt(task(name), skeleton=name not in PAPER)
    assert recorded(shipped(name)).prompt_sha256 == sha256(prompt.encode())


@every_task
def test_range(name):
    """On the scale of the residual, [-1, 1]; the walker's, as printed, in [0, 2]."""
    rng = np.random.default_rng(0)
    prior = load_prior("language")
    values = np.array([prior(random_step(name, rng)) for _ in range(500)])
    low, high = (0, 2) if name == "walker-walk" else (-1, 1)
    if name in ("walker-walk", "quadruped-walk"):  # a random z lies beyond what a rotation gives
        values = values[(values >= low) & (values <= high)]
        assert len(values) > 200
    assert low <= values.min() < values.max() <= high
    assert values.std() > 0.05


def walking(**outcomes):
    spec = task("walker-walk")
    obs = np.zeros(spec.spaces.obs, np.float32)
    return PriorStep(spec, obs, np.zeros(6, np.float32), outcomes, np.random.default_rng(0), Scene(spec, obs))


@pytest.mark.parametrize(
    ("speed", "z", "height", "expected"),
    [
        (1.0, 1.0, 1.2, 2.0),
        (0.0, 1.0, 1.2, math.exp(-8) + 1.0),
        (1.25, 0.0, 1.0, math.exp(-0.5) + 0.25 + 0.5 * math.exp(-0.5)),
        (-3.0, -1.0, 5.0, 0.0),
    ],
)
def test_walker_is_the_papers(speed, z, height, expected):
    """The printed sum of two Gaussians and the uprightness, of the state that the step led to."""
    step = walking(forward_velocity=speed, torso_upright=z, torso_height=height)
    assert load_prior("language")(step) == pytest.approx(expected, abs=1e-12)


def norm(*way):
    return math.sqrt(sum(part * part for part in np.subtract(*way)))


@given(*[st.tuples(*[st.floats(-1, 1, width=32)] * 3)] * 4)
@example((0, 0, 0), (0, 0, 0), (0, 0, 0), (0, 0, 0))
def test_the_image_tasks_are_the_papers(hand, start, o_init, goal):
    """The two printed formulas, of the hand, where it began, where the object was, and the goal."""
    by_goal = 1 - norm(hand, goal) / (norm(goal, start) + 1e-8)
    by_object = 1 - norm(hand, o_init) / (norm(o_init, start) + 1e-8)
    expected = {"button-press-image": by_goal, "sweep-into-image": 0.1 * by_goal + 0.9 * by_object}
    for name, share in expected.items():
        spec = task(name)
        obs = np.array([*hand, 1.0, *o_init, *goal], np.float32)
        first = np.array([*start, 1.0, *o_init, *goal], np.float32)
        step = PriorStep(spec, obs, np.zeros(4, np.float32), {}, np.random.default_rng(0), Scene(spec, first))
        assert load_prior("language")(step) == pytest.approx(2 * min(max(share, 0), 1) - 1, abs=1e-6)


@pytest.mark.slow
@pytest.mark.sim
@pytest.mark.parametrize("seed", range(3))
def test_the_way_that_the_printed_function_praises_presses_the_button(seed):
    """A hand that goes straight for the hole, where the function is at its highest, meets the button on the way."""
    env = make("button-press")
    obs, _ = env.reset(seed=seed)
    way, success = np.inf, 0.0
    for _ in range(100):
        nearer = np.linalg.norm(obs[36:39] - obs[:3])
        way = min(way, nearer)
        action = np.append(np.clip(10 * (obs[36:39] - obs[:3]), -1, 1), 0.0).astype(np.float32)
        obs, _, _, _, info = env.step(action)
        success = max(success, info["success"])
    env.close()
    assert success == 1.0
    assert way < 0.05  # the hole is reached


ARM = {"hand": slice(0, 3), "object": slice(4, 7), "goal": slice(36, 39)}


@pytest.mark.parametrize("name", [name for name, spec in TASKS.items() if spec.suite == "metaworld"])
def test_arms_praise_progress(name):
    """From the start to a hand on the object, to an object half-way, to the goal: each is worth more than the last."""
    spec, prior = task(name), load_prior("language")

    def value(hand, share):
        obs = np.zeros(spec.spaces.obs, np.float32)
        start, goal = np.array([0.0, 0.6, 0.1]), np.array([0.2, 0.8, 0.1])
        first = obs.copy()
        first[ARM["object"]], first[ARM["goal"]] = start, goal
        obs[ARM["goal"]], obs[ARM["object"]] = goal, start + share * (goal - start)
        obs[ARM["hand"]] = obs[ARM["object"]] + hand
        return prior(PriorStep(spec, obs, np.zeros(4, np.float32), {}, np.random.default_rng(0), Scene(spec, first)))

    away, there = np.array([0.1, -0.2, 0.2]), np.array([0.01, 0.0, 0.02])
    ordered = [value(away, 0.0), value(there, 0.0), value(there, 0.5), value(there, 1.0)]
    assert ordered == sorted(ordered)
    assert len(set(ordered)) == 4


def test_records_survive(tmp_path):
    """What is frozen is read back, quotes and all, and the code under it runs."""
    name, record = frozen(tmp_path)
    assert recorded(tmp_path / "mine.language.py") == record
    step = random_step("toy-car", np.random.default_rng(0))
    assert load_prior(name)(step) == step.hand[0]


@pytest.mark.parametrize(
    ("body", "name", "said"),
    [
        ("return open('x')", "toy-car", r"line \d+: `open`"),
        ("return step.hand[0]", "button-press", "was written for button-press, not for toy-car"),
        ("return step.upright", "toy-car", "reads upright, which toy-car does not reveal; it reveals: hand, object"),
        ("return step.forward_velocity", "toy-car", "reads forward_velocity, which toy-car does not reveal"),
    ],
)
def test_planning_refuses(tmp_path, body, name, said):
    """A frozen file that cannot serve is refused before the run, by the configuration itself."""
    file, _ = frozen(tmp_path, body, name)
    with pytest.raises(ValidationError, match=said):
        RunConfig(task="toy-car", seed=0, steps=2000, reward=RewardConfig(prior=file))


def test_a_frozen_file_is_never_run_as_a_module(tmp_path):
    """By its name alone: code that has no record, or does more than a prior may, is refused even without the check."""
    file = tmp_path / "x.language.py"
    file.write_text(f"open({str(tmp_path / 'ran')!r}, 'w')\ndef reward(step):\n    return 0.0\n")
    with pytest.raises(PriorError, match="line 1"):
        load_prior(f"{file}:reward")
    file.write_bytes(code("return 0.0"))
    with pytest.raises(ConfigError, match="has no record"):
        load_frozen(f"{file}:reward")
    with pytest.raises(PriorError, match="a language prior is called reward"):
        load_frozen(f"{file}:other")
    with pytest.raises(ConfigError, match="cannot read"):
        check_frozen(f"{tmp_path}/none.language.py:reward", task("toy-car"))
    assert not (tmp_path / "ran").exists()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("# task", "# tusk"), "damaged"),
        (("[[candidates]]", "[candidates"), "damaged"),
        (("# ///\n", "\n"), "no record"),
        (("score = 0.5", "score = " + "9" * 5000), "damaged"),
        (("score = 0.5", "score = " + "[" * 5000), "damaged"),
    ],
)
def test_damaged_records(tmp_path, change, said):
    """The file is named, and what is wrong with it."""
    name, _ = frozen(tmp_path)
    file = tmp_path / "mine.language.py"
    file.write_text(file.read_text().replace(*change))
    with pytest.raises(ConfigError, match=rf"mine\.language\.py.*{said}"):
        load_frozen(name)


def test_identity(tmp_path):
    """The record is part of the file: the same code of another model is another run."""
    file, _ = frozen(tmp_path)
    config = RunConfig(task="toy-car", seed=0, steps=2000, reward=RewardConfig(prior=file))
    before = config.identity
    path = tmp_path / "mine.language.py"
    path.write_text(path.read_text().replace('"M"', '"N"'))
    assert config.identity != before
