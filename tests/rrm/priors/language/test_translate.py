"""What a model's code may do, and that it then does what Python would."""

import math

import numpy as np
import pytest

from rrm.errors import PriorError
from rrm.priors.language.translate import admit
from rrm.priors.step import evaluate_prior
from tests.rrm.priors.language.steps import code, random_step

#: Bodies of the kind that models write, with what stands above them.
BODIES = [
    ("return -np.linalg.norm(step.hand - step.object) - np.linalg.norm(step.object - step.goal)", ""),
    ("return 2.0 * np.clip(1 - math.dist(step.hand, step.goal) / 3, 0, 1) - 1", ""),
    ("return np.clip(step.hand[0], a_min=-0.5, a_max=W)", "W = 0.25"),
    ("return float(np.tanh(np.sum(np.square(step.act))) ** 2 % 0.3 // 0.1)", ""),
    ("return np.where(step.act > 0, step.act, 0.1 * step.act)[0]", ""),
    ("return (step.hand > 0)[0] * 1.0 + np.mean([step.hand, step.goal]) + np.power(2, 3) + True", ""),
    ("x = y = max(step.hand[0], 0.0, step.goal[1])\nreturn min((x, y, 1)) + sum([x, y]) - abs(-x)", ""),
    (
        "return _g(step.hand[0], 0.5) + _g(step.obs[-1], mu=0.1, sigma=2.0)",
        "def _g(x, mu, sigma=0.5):\n    return np.exp(-0.5 * ((x - mu) / sigma) ** 2)",
    ),
    (
        "up, side = frame(step)\nreturn np.dot(up, side) + np.arctan2(up[0], side[1])",
        "import math as m\nZ = np.array([0, 0, 1])\ndef frame(step):\n    return np.cross(step.hand, Z), step.goal",
    ),
    (
        "a, b = step.hand, step.first.hand\nmoved = np.linalg.norm(a[:2] - b[:2], ord=1)\n"
        "return moved if moved < 1 and not moved < 0.1 or a[0] > 0 else -1.0",
        "",
    ),
    (
        "total = 0.0\nfor w, d in ((0.5, step.hand), (0.25, step.goal)):\n    total += w * np.max(np.abs(d))\n"
        "for i in range(1, 3):\n    if i == 2:\n        continue\n    total += step.obs[i] * i\nreturn total",
        "",
    ),
    (
        "if step.hand[2] < 0.1:\n    return 0\nelif 0 < step.hand[2] <= 1:\n    return True\nelse:\n    pass\n"
        "return math.pi + math.hypot(3, 4)",
        "",
    ),
]


@pytest.mark.parametrize(("body", "before"), BODIES)
def test_it_computes_what_python_computes(body, before):
    """The rebuilt code and the text, run as it stands, agree on random states (to the float32 of observations)."""
    source = code(body, before)
    room: dict = {}
    exec(source, room)
    function = admit(source, "a.py").function()
    rng = np.random.default_rng(0)
    for _ in range(50):
        step = random_step("button-press", rng)
        assert evaluate_prior(function, step, "x") == pytest.approx(float(room["reward"](step)), rel=1e-5)


def test_reads():
    """What the code looks at is known before it runs."""
    admitted = admit(code("x = step.first\nreturn x.upright + step.forward_velocity * step.obs[0]"), "a.py")
    assert admitted.reads == {"first", "upright", "forward_velocity", "obs"}


@pytest.mark.parametrize(
    ("body", "said"),
    [
        ("return step.hand.sum()", r"line 6: `step.hand.sum` \(Attribute\): not a function that can be called here"),
        ("return open('x')", r"line 6: `open` \(Name\): not a function that can be called"),
        ("x = [i for i in step.hand]\nreturn x", r"line 6: `\[i for i in step.hand\]` \(ListComp\): this kind"),
        ("while True:\n    pass", r"line 6: `while True: pass` \(While\): this kind of statement"),
        ("x = 0.0\nreturn x +\\\n y", r"line 8: `y` \(Name\): not a parameter, variable or constant"),
        ("return np.linalg.norm(step.hand, 2, 0)", r"numpy.linalg.norm takes at most 2 plain arguments"),
        ("return step.info['unscaled_reward']", r"`step.info` \(Attribute\): what can be read, of the step, is act, "),
        ("return 'a'", r"`'a'` \(Constant\): values that can be written are numbers"),
        ("return (" + " + ".join(["step.hand[0]"] * 9) + ") @ 1", r"`.{57}\.\.\.` \(BinOp\): operators are"),
    ],
)
def test_refusals_name_the_construct(body, said):
    """The message gives file, line, code and what is allowed instead."""
    with pytest.raises(PriorError, match=r"^answer\.py, .*" + said):
        admit(code(body), "answer.py")


@pytest.mark.parametrize(
    ("body", "said"),
    [("x = 1.0\nreturn x / 0", "ZeroDivisionError"), ("x = 1.0\nreturn np.cross(step.obs, step.obs)", "ValueError")],
)
def test_a_failing_line_is_named(body, said):
    """When admitted code fails, the message leads to the line of the model's file, not to numpy's."""
    function = admit(code(body), "answer.py").function()
    with pytest.raises(PriorError, match=rf"(?s)p raised {said}: .* \(answer\.py, line 7\)"):
        evaluate_prior(function, random_step("toy-car", np.random.default_rng(0)), "p")


def test_a_failing_constant_is_refused():
    """A constant that cannot be computed is a mistake of the file."""
    with pytest.raises(PriorError, match=r"a\.py, line 3: ValueError in a constant: math domain error"):
        admit(code("return W", f"W = math.log({math.pi} - 4)"), "a.py").function()
