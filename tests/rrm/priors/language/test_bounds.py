"""Every admitted function ends, in little memory; what would not is refused with its line."""

import random
import re
import sys
import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rrm.errors import PriorError, RefusedCodeError
from rrm.priors.language.guards import LARGEST, MOST_AXES, checked_value
from rrm.priors.language.translate import MOST_WORK, admit
from rrm.priors.language.vocabulary import SIGNATURES
from rrm.priors.step import evaluate_prior
from tests.rrm.priors.language.steps import code, random_step

_MEMORY = 64 << 20  # bytes; what two arrays give before anybody can see how large it is, and a little more


def nested(loops, inner, turns=100):
    """A body with one loop in another."""
    lines = [f"{'    ' * depth}for i{depth} in range({turns}):" for depth in range(loops)]
    return "\n".join([*lines, "    " * loops + inner, "return 0.0"])


def run(body, before="", limit=_MEMORY):
    """Call an admitted function once, and see to it that it keeps its promise; its value, or its error."""
    function = admit(code(body, before), "a.py").function()
    step = random_step("button-press", np.random.default_rng(0))
    seen = {"lines": 0, "values": 0}

    def inside(frame, event, value):
        if event == "line" and frame.f_code.co_filename == "a.py":
            seen["lines"] += 1
        elif event == "return" and frame.f_code is checked_value.__code__:
            seen["values"] += 1
            for item in value if isinstance(value, tuple) else (value,):
                assert np.ndim(item) <= MOST_AXES
                assert np.size(item) <= LARGEST
        assert max(seen.values()) <= 2 * MOST_WORK
        return inside

    tracemalloc.start()
    sys.settrace(lambda frame, event, value: inside)
    try:
        with np.errstate(all="ignore"):
            return evaluate_prior(function, step, 'prior "mine" at step 7')
    except PriorError as error:
        return error
    finally:
        sys.settrace(None)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < limit


@pytest.mark.parametrize(
    "body",
    [
        nested(10, "pass"),
        nested(10, "'nothing'"),
        nested(10, "continue"),
        nested(2, "break"),
        nested(2, "i = 1.0 if step.object[1] > 2.1 else 2.0"),
        nested(1, "x = y = z = 1.0", 100).replace("x", " = ".join(f"x{n}" for n in range(200))),
        "if step.object[1] > 2.1:\n    " + nested(10, "pass").replace("\n", "\n    ") + "\nreturn 1.0",
    ],
    ids=["pass", "text", "continue", "break", "value", "targets", "rarely"],
)
def test_every_statement_costs(body):
    """Loops around what computes nothing are counted like others, whether or not a random walk gets there."""
    with pytest.raises(RefusedCodeError, match=r"^a\.py, line \d+: .*would take more than 15,000 operations"):
        admit(code(body), "a.py")


def test_calls_of_empty_functions_cost():
    """Functions that call functions that do nothing."""
    before = "def f0(x):\n    pass\n"
    for level in range(1, 20):
        before += f"def f{level}(x):\n    for i in range(100):\n        f = f{level - 1}(x)\n    return x\n"
    with pytest.raises(RefusedCodeError, match=r"line 11: `f1\(x\)` .*would take more"):
        admit(code("return f19(1.0)", before), "a.py")


def test_calls_are_not_deep():
    """A chain of calls stays far from where Python ends it, wherever in training it begins."""
    before = "def f0(x):\n    return x\n"
    for level in range(1, 40):
        before += f"def f{level}(x):\n    return f{level - 1}(x)\n"
    with pytest.raises(RefusedCodeError, match="line 67: 32 functions are the most"):
        admit(code("return f39(1.0)", before), "a.py")


def test_many_loops_in_one_another_are_refused_when_read():
    """Python knows twenty at the most: that, too, is seen in planning and not in training."""
    with pytest.raises(RefusedCodeError, match=r"a\.py, line \d+: too many statically nested blocks"):
        admit(code(nested(21, "pass", 1)), "a.py")


@pytest.mark.parametrize(
    ("body", "said"),
    [
        ("x = step.obs\nfor i in range(40):\n    x = x == (" + "x, " * 32 + ")\nreturn 0.0", "an array of shape"),
        ("x = step.obs\nfor i in range(40):\n    x = x < [" + "x, " * 32 + "]\nreturn 0.0", "an array of shape"),
        ("x = step.obs\nfor i in range(40):\n    x = x or (" + "x, " * 32 + ")\nreturn 0.0", "ambiguous"),
        ("x = step.obs\nfor i in range(40):\n    x = (x, x) if i < 40 else x\nreturn 0.0", "a tuple inside a tuple"),
        ("x = -np.array([" + "step.obs, " * 32 + "])\nreturn 0.0", "an array of shape"),
        ("x = _pair(step.obs)\nreturn 0.0", "a tuple inside a tuple"),
    ],
)
def test_every_value_is_checked(body, said):
    """Whatever kind of expression makes it: comparisons, choices and what functions return grow no more than sums."""
    error = run(body, "def _pair(x):\n    y = (x, x)\n    return (y, y)\n")
    assert isinstance(error, PriorError)
    assert said in str(error)
    assert str(error).startswith('prior "mine" at step 7 raised ')
    assert "(a.py, line " in str(error)


@pytest.mark.parametrize(
    "body",
    [
        "for i in range(3):\n    i = step.hand < 0\n    x = step.obs[i]\nreturn 0.0",
        "for i in range(3):\n    i += 1\nreturn 0.0",
        "for i in range(3):\n    for i in (step.obs, 2.0):\n        x = step.obs[i]\nreturn 0.0",
        "for i in range(3):\n    x, i = step.hand, step.hand\nreturn 0.0",
        "i = step.hand < 0\nfor i in range(0):\n    pass\nreturn step.obs[i]",
        "for step in range(0):\n    pass\nreturn step[step]",
        "for i in range(3):\n    i: float = 2.0\nreturn 0.0",
    ],
)
def test_a_counter_counts_and_nothing_else(body):
    """A name that may be an index is bound by its loops alone."""
    with pytest.raises(RefusedCodeError, match=r"line \d+: (i|step) is a (counter|variable) already"):
        admit(code(body), "a.py")


@pytest.mark.parametrize(
    ("head", "name"),
    [
        ("def reward(step: (hidden := 1)):\n    return hidden", "hidden"),
        ("def reward(step) -> (hidden := 1):\n    return hidden", "hidden"),
        ("def reward(step):\n    x: (__builtins__ := 1) = 2.0\n    return __builtins__", "__builtins__"),
        ("def reward(step):\n    x: [abs for abs in (1,)] = 2.0\n    return abs", "abs"),
        ("def reward(step):\n    x = y\n    y = 1.0\n    return x", "y"),
        ("def reward(step):\n    x += 1.0\n    return x", "x"),
    ],
)
def test_only_what_is_bound_is_read(head, name):
    """What stands in an annotation is dropped with all the names in it; the others are bound above."""
    with pytest.raises(RefusedCodeError, match=rf"line \d: `{name}.*not a parameter, variable or constant"):
        admit(head.encode() + b"\n", "a.py")


@pytest.mark.parametrize(
    "value", ["0x" + "f" * 3600, "0b" + "1" * 19_000, "-0x" + "f" * 3600, "step.obs[0x" + "f" * 3600 + "]"]
)
def test_endless_numbers_are_refused(value):
    """Without writing them out in decimal, which Python would not do."""
    with pytest.raises(RefusedCodeError, match=r"^a\.py, line 6: `.*\.\.\.`"):
        admit(code(f"return {value}"), "a.py")


def test_a_record_takes_no_room_from_the_code():
    """A candidate that is admitted is admitted under a record of any length, too."""
    source = code("return 0.0") + b"#" * 19_000
    assert admit(b"# a reason\n" * 5000 + source, "a.py")


NAMES = ["x", "y", "z", "n", "n2", "W", "step.obs", "step.hand", "step.act", "1", "2.5", "1e9", "True"]
OPERATORS = ["+", "-", "*", "/", "//", "%", "**", "<", "<=", "==", "!=", "and", "or"]
INDICES = ["0", "-1", ":2", "1:", "n", "n2", ":n", "-100:100"]
BEGIN = "x = y = z = 0.5\nfor n in range(2):\n    pass\nfor n2 in range(2):\n    pass\n"


def expression(rng, depth=3):
    """One out of the admitted grammar."""
    if depth == 0:
        return rng.choice(NAMES)
    a, b, c = (expression(rng, rng.randrange(depth)) for _ in range(3))
    row = ", ".join([rng.choice(NAMES)] * rng.randint(1, 32))
    called = rng.choice(sorted(SIGNATURES))
    given = ", ".join([a, b, c][: SIGNATURES[called].most])
    return rng.choice([
        f"({a} {rng.choice(OPERATORS)} {b})", f"({a} == ({row},))", f"np.array([{row}])", f"np.array(({a}, {a}))",
        f"{called.replace('numpy.', 'np.')}({given})", f"({a})[{rng.choice(INDICES)}]", f"({a}, {b})", f"(-{a})",
        f"(np.sum({a}) < {b} < {c})", f"({a} if np.sum({b}) else {c})", f"np.dot({a}, {b})", f"np.where({a}, {b}, {c})",
        f"np.sum({a})", f"(not np.sum({a}))", f"f(step, {a})",
    ])  # fmt: skip


def block(rng, depth=4):
    """Its lines; names beginning with n count, the others hold whatever there is."""
    lines = []
    for _ in range(rng.randint(1, 3)):
        value, turns = expression(rng), rng.choice([0, 1, 3, 30, 100])
        if depth and rng.random() < 0.5:
            heads = ["for n in range({0}):", "for n2 in range({0}):", "if np.sum({1}):", "for z in ({1}, 1.0, x):"]
            lines.append(rng.choice(heads).format(turns, value))
            lines += [f"    {line}" for line in block(rng, depth - 1)]
        else:
            lines.append(rng.choice([f"x = {value}", f"y = {value}", f"x += {value}", f"y, z = {value}, x", "pass"]))
    return lines


def program(rng):
    """A body, and what stands above it: a constant, and a function that the body may call."""
    helper = "\n    ".join([*BEGIN.split("\n"), *block(rng, 2), "return x"]).replace("f(step, ", "np.square(")
    above = f"W = np.array([0.0, 1.0, 2.0])\n\ndef f(step, other=1.0):\n    {helper}\n"
    return "\n".join([BEGIN, *block(rng), "return x"]), above


@pytest.mark.slow
@settings(max_examples=100, deadline=None)
@given(st.integers(0, 2**32))
def test_whatever_is_admitted_ends(seed):
    """Programs of the grammar are refused with a line, or keep to their work and memory, whatever they compute."""
    try:
        run(*program(random.Random(seed)))
    except RefusedCodeError as error:
        refused = str(error)
    else:
        return
    assert re.match(r"a\.py, line \d+: .*(would take more|characters of code)", refused)
