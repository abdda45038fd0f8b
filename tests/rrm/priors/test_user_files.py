"""Priors of users' own: how they are found, and what is said when they fail."""

import numpy as np
import pytest
import torch

from rrm.envs import task
from rrm.errors import ConfigError, PriorError
from rrm.priors import check_prior, load_prior
from rrm.priors.step import PriorStep, Scene, evaluate_prior

TOY = task("toy-car")


@pytest.fixture
def toy_step():
    obs = np.arange(TOY.spaces.obs, dtype=np.float32)
    first = Scene(TOY, np.ones(TOY.spaces.obs, np.float32))
    return PriorStep(TOY, obs, np.array([0.25, -1], np.float32), {"success": 1.0}, np.random.default_rng(0), first)


@pytest.fixture
def own(tmp_path):
    """Write a file of priors, and name one of them."""

    def write(source, function="prior"):
        (tmp_path / "mine.py").write_text(source)
        return f"{tmp_path / 'mine.py'}:{function}"

    return write


def test_everything_a_prior_may_see(own, toy_step):
    """Features, observation, action, outcome, first state and generator reach a user's function."""
    name = own(
        "import math\n"
        "def prior(step):\n"
        "    draw = step.rng.uniform()\n"
        "    assert 0 <= draw < 1\n"
        "    assert step.reveals('clearance') and not step.reveals('upright')\n"
        "    moved = math.dist(step.hand, step.first.hand)\n"
        "    return moved + step.obs[3] + step.act[0] + step.success + step.info['success'] + step.clearance\n"
    )
    check_prior(name, TOY)
    assert evaluate_prior(load_prior(name), toy_step, "x") == pytest.approx(1 + 3 + 0.25 + 1 + 1 + 4)


def test_missing_file(tmp_path):
    """Planning refuses a file that is not there, and says where it looked."""
    with pytest.raises(ConfigError, match=r"there is no file /.*nowhere\.py$"):
        check_prior(f"{tmp_path}/nowhere.py:prior", TOY)


def test_planning_does_not_run_the_file(own):
    """A file that would raise on import passes the check and is refused at the start of the run."""
    name = own("raise RuntimeError('on import')\ndef prior(step): ...")
    check_prior(name, TOY)
    with pytest.raises(ConfigError, match=r"mine\.py does not import: RuntimeError: on import"):
        load_prior(name)


def test_missing_function(own):
    """The message names the file and the function."""
    with pytest.raises(ConfigError, match=r"mine\.py defines no 'prior'"):
        load_prior(own("def other(step): return 0"))


def test_planning_misses_the_function_too(own):
    """What the file plainly does not define is refused before the run, with what was perhaps meant."""
    with pytest.raises(ConfigError, match=r"mine\.py defines no 'prior'; did you mean \"prio\"\?"):
        check_prior(own("def prio(step): return 0"), TOY)


def test_file_without_a_function():
    """The form of a user's prior is spelled out."""
    with pytest.raises(ConfigError, match=r"named path/to/file\.py:function"):
        check_prior("mine.py", TOY)


def test_not_callable(own):
    """Something that cannot be called is refused with its type."""
    with pytest.raises(PriorError, match="is a float; a prior is a function of one PriorStep"):
        load_prior(own("prior = 3.0"))


@pytest.mark.parametrize(
    "value", [2, 2.0, np.float32(2), np.int64(2), np.array(2.0), torch.tensor(2.0)], ids=lambda v: type(v).__name__
)
def test_numbers(value, toy_step):
    """Anything that is one number will do, and a plain float comes out."""
    result = evaluate_prior(lambda _: value, toy_step, "x")
    assert result == 2.0
    assert type(result) is float


@pytest.mark.parametrize(
    ("value", "said"),
    [
        (None, r"returned None \(NoneType\); a prior returns one number per step"),
        ("3", r"returned '3' \(str\); a prior returns one number"),
        ([1.0], r"returned \[1.0\] \(list\)"),
        (np.zeros(3), r"returned array\(\[0., 0., 0.\]\) \(ndarray of shape \(3,\)\)"),
        (np.zeros(1), r"\(ndarray of shape \(1,\)\)"),
        (torch.zeros(2, 1), r"\(Tensor of shape \(2, 1\)\)"),
        (np.array("3"), r"ndarray of shape \(\)|str"),
        (float("nan"), "returned nan; a prior returns a finite number"),
        (np.float32("inf"), "returned inf; a prior returns a finite number"),
        (1j, "returned 1j"),
    ],
)
def test_not_a_number(value, said, toy_step):
    """The message names prior and step, shows the value, and says what is wanted."""
    with pytest.raises(PriorError, match=f'^prior "mine" at step 12 .*{said}'):
        evaluate_prior(lambda _: value, toy_step, 'prior "mine" at step 12')


def test_long_values_are_cut(toy_step):
    """A huge return value does not fill the screen."""
    with pytest.raises(PriorError) as caught:
        evaluate_prior(lambda _: list(range(10_000)), toy_step, "x")
    assert len(str(caught.value)) < 200


def test_raising(own, toy_step):
    """What was raised is named with its line, and chained."""
    prior = load_prior(own("def prior(step):\n    return 1 / 0\n"))
    with pytest.raises(
        PriorError, match=r"^p raised ZeroDivisionError: division by zero \(.*mine\.py, line 2\)$"
    ) as caught:
        evaluate_prior(prior, toy_step, "p")
    assert isinstance(caught.value.__cause__, ZeroDivisionError)


def test_wrong_signature(toy_step):
    """A function that does not take the step is a prior that raises."""
    with pytest.raises(PriorError, match=r"p raised TypeError: .*positional argument"):
        evaluate_prior(lambda a, b: 0, toy_step, "p")


def test_hidden_feature(own, toy_step):
    """A feature that the task does not reveal is reported as such, with prior and step."""
    prior = load_prior(own("def prior(step):\n    return step.upright\n"))
    with pytest.raises(PriorError, match=r'^p: toy-car does not reveal "upright"; it reveals: hand, object'):
        evaluate_prior(prior, toy_step, "p")
