"""What a model's code may never do: known ways out of restricted Python, each refused with its line."""

import dis
import re
from types import CodeType

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rrm.errors import PriorError, RefusedCodeError, RrmError
from rrm.priors.language.guards import FUNCTIONS, OPERATIONS, namespace
from rrm.priors.language.translate import admit
from rrm.priors.language.vocabulary import ACCESSORS, SIGNATURES, VALUE
from rrm.priors.step import evaluate_prior
from tests.rrm.priors.language.steps import code, random_step

#: One expression each, standing in `return ...`.
EXPRESSIONS = [
    # objects behind objects
    "().__class__.__bases__[0].__subclasses__()",
    "step.__class__",
    "step.hand.__array_interface__",
    "step.hand.base",
    "step.hand.ctypes",
    "step.obs.tofile",
    "step.hand.dump",
    "step.hand.sum()",
    "reward.__globals__",
    "(lambda: 0).__code__",
    "step.rng.uniform()",
    "step.task",
    "step.info",
    "step.feature",
    "step.reveals",
    "step.success",
    "step.first.task",
    "np.__dict__",
    "np.__builtins__",
    "math.__loader__",
    "np.exp.__class__",
    "np.pi.__class__",
    "np",
    "math",
    "reward",
    "np.exp",
    "print",
    # modules and files
    "np.load('x')",
    "np.fromfile('x')",
    "np.save('x', step.obs)",
    "np.loadtxt('x')",
    "np.memmap('x')",
    "np.lib",
    "np.ctypeslib",
    "np.linalg",
    "np.linalg.lapack_lite",
    "np.random.rand()",
    "np.vectorize(abs)",
    "np.frompyfunc(abs, 1, 1)",
    "np.apply_along_axis(abs, 0, step.obs)",
    "np.testing",
    "np.f2py",
    "np.dtype('O')",
    "np.core",
    "np.exp(step.obs, step.obs)",
    "np.exp(step.obs, out=step.obs)",
    "np.exp(1.0, where=step.obs)",
    "np.exp(1.0, dtype=object)",
    "np.array([1], dtype=object)",
    "np.maximum(1, 2, step.obs)",
    "np.add.reduce(step.obs)",
    "math.factorial(10)",
    "math.comb(10, 3)",
    "math.prod((1, 2))",
    # builtins
    "getattr(step, 'rng')",
    "eval('1')",
    "exec('1')",
    "open('x')",
    "__import__('os')",
    "__builtins__",
    "globals()",
    "vars(step)",
    "type(step)",
    "dir(step)",
    "input()",
    "breakpoint()",
    "compile('1', 'x', 'eval')",
    "hasattr(step, 'rng')",
    "int(1e300)",
    "round(1e300)",
    "pow(10, 10)",
    "str(1)",
    "bytes(10)",
    "list(step.obs)",
    "range(10)",
    "map(abs, step.obs)",
    "super()",
    # texts
    "'x' * 1000000000",
    "'{0.__class__}'.format(step)",
    "f'{step.rng}'",
    "f'{step!r:>1000000000}'",
    "'%1000000000d' % 1",
    "b'x'",
    "...",
    "None",
    "1j",
    # syntax
    "(x := 1)",
    "lambda: 1",
    "(lambda x=step: x)()",
    "[x for x in step.obs]",
    "sum(x for x in step.obs)",
    "{x: 1 for x in step.obs}",
    "{1, 2}",
    "{1: 2}",
    "max(*step.obs)",
    "np.linalg.norm(**step.first)",
    "(*step.obs, 1)",
    "step.obs[np.array([0])]",
    "step.obs[None]",
    "step.obs[True]",
    "step.obs[...]",
    "step.obs[::2]",
    "step.obs[0, 1]",
    "step.obs[step.obs]",
    "1 is 1",
    "1 in (1, 2)",
    "1 << 1000000000",
    "1 | 2",
    "~1",
    "step.obs @ step.obs",
    "await step",
    "yield",
    "max(1, 2, key=abs)",
    # numbers
    "1e999",
    "10000000000",
    "-1e10",
    "0x" + "f" * 400,
    "9" * 5000,
    # recursion
    "reward(step)",
    # names that become others
    "ｇｅｔａｔｔｒ(step, 1)",
    "step.ｒｎｇ",
    "step.__ｃlass__",
    "ｎｐ.load",
    "ᵉval(1)",
]


@pytest.mark.parametrize("expression", EXPRESSIONS)
def test_expressions(expression):
    """Refused with the line on which it stands."""
    with pytest.raises(RefusedCodeError, match=r"^answer\.py, line 6: "):
        admit(code(f"return {expression}"), "answer.py")


#: Whole files. Where not refused for another reason, they would define a reward.
FILES = [
    "import os",
    "import numpy.ctypeslib",
    "import numpy, os",
    "import numpy as __builtins__",
    "from numpy import load",
    "from numpy import *",
    "from os import system as exp",
    "from __future__ import annotations",
    "X = [].append",
    "X = __import__('os')",
    "X: int = 3",
    "X += 1",
    "X = Y = 1",
    "X, Y = 1, 2",
    "X = helper(1)",
    "X = 1\nX = 2",
    "np = 1",
    "max = 1",
    "reward = 1",
    "__x__ = 1",
    "print()",
    "if True: pass",
    "while True: pass",
    "class Reward: pass",
    "async def f(): pass",
    "@staticmethod\ndef f(x): return x",
    "@(lambda f: f)\ndef f(x): return x",
    "def f(x=[]): return x",
    "def f(x=lambda: 1): return x",
    "def f(x=print): return x",
    "def f(x='s'): return x",
    "def f(*x): return x",
    "def f(**x): return x",
    "def f(x, /): return x",
    "def f(*, x): return x",
    "def f(__x): return 1",
    "def f(np): return np.load",
    "def f(x): return f(x)",
    "def f(x): return later(x)\ndef later(x): return f(x)",
    "def f(x): return x\ndef f(x): return x",
    "def max(x): return x",
    "def f(x):\n    def g(y): return y\n    return g(x)",
    "def f(x):\n    import os\n    return x",
    "def f(x):\n    global step\n    return x",
    "def f(x):\n    while x: x = x - 1\n    return x",
    "def f(x):\n    for i in x: pass\n    return x",
    "def f(x):\n    for i in range(x): pass\n    return x",
    "def f(x):\n    for i in range(1000000000): pass\n    return x",
    "def f(x):\n    for i in range(10 ** 10): pass\n    return x",
    "def f(x):\n    for i in range(): pass\n    return x",
    "def f(x):\n    for i in range(0, 10, 0): pass\n    return x",
    "def f(x):\n    for x.hand in (1, 2): pass\n    return x",
    "def f(x):\n    for i in (1, 2): pass\n    else: pass\n    return x",
    "def f(x):\n    x.hand = 1\n    return x",
    "def f(x):\n    x.hand[0] = 1\n    return x",
    "def f(x):\n    x.hand += 1\n    return x",
    "def f(x):\n    x: __import__('os')\n    return x",
    "def f(x):\n    a, *b = x, x\n    return a",
    "def f(x):\n    [a, b] = x, x\n    return a",
    "def f(x):\n    del x\n    return 1",
    "def f(x):\n    raise x",
    "def f(x):\n    assert x\n    return x",
    "def f(x):\n    try: return x\n    except: return 1",
    "def f(x):\n    with x: return 1",
    "def f(x):\n    match x:\n        case 1: return 1",
    "def f(x):\n    break",
    "def f(x):\n    return",
    "def f(x):\n    f.x = 1\n    return 1",
    "def f(x):\n    np = x\n    return 1",
    "def f(x):\n    abs = x\n    return 1",
    "def f(x):\n    range = x\n    return 1",
]


@pytest.mark.parametrize("before", FILES)
def test_files(before):
    """Refused before anything is run, with the line."""
    text = f"import numpy as np\n{before}\n\ndef reward(step):\n    return 0.0\n"
    with pytest.raises(RefusedCodeError, match=r"^a\.py, line [2-5]: "):
        admit(text.encode(), "a.py")


@pytest.mark.parametrize(
    ("source", "said"),
    [
        (b"", r"no function reward\(step\)"),
        (b"def reward(step, more):\n    return 0.0\n", "line 1: reward has one parameter, the step"),
        (b"def reward(step=1):\n    return 0.0\n", "line 1: reward has one parameter, the step"),
        (b"def reward(step)\n    return 0.0\n", "line 1: expected ':'"),
        (b"\xff\xfe", "not UTF-8 text"),
        (b"# -*- coding: utf-7 -*-\n+AAo-import os\n", "line 2"),
        ("# \u202e tfel ot thgir\n".encode(), "line 1: an invisible character"),
        (b"x = 1\x0cimport os\n", "line 1: an invisible character"),
        (b"x = '\x00'\n", "line 1: an invisible character"),
        (b"x = " + b"(" * 150 + b"1" + b")" * 150, "nested parentheses|no function"),
        (b"x = " + b"(" * 5000 + b"1" + b")" * 5000, "too many nested parentheses"),
        (b"x = " + b"-" * 1000 + b"1", "nested too deeply"),
        (b"x = " + b"(lambda: " * 70 + b"1" + b")" * 70, "line 1: nested too deeply"),
        (b"x = " + b"-" * 15_000 + b"1", "nested too deeply"),
        (b"x = " + b"1+" * 9000 + b"1", "nested too deeply"),
        (b"x = 1\n" * 5000, r"line 4001: more than 20,000 characters of code"),
        (b"x = (" + b"1," * 33 + b")", "33 items; 32 are the most"),
    ],
)
def test_shapes(source, said):
    """Files that are no code, or meant to overwhelm whoever reads them."""
    with pytest.raises(RefusedCodeError, match=said):
        admit(source, "a.py")


def test_work_is_counted_through_loops_and_calls():
    """Nested loops multiply, and so do calls of functions that call others: what would take forever is not begun."""
    loops = "x = 0.0\nfor i in range(100):\n    for j in range(100):\n        x += 1.0\nreturn x"
    with pytest.raises(RefusedCodeError, match=r"line 9: .*more than 15,000 operations"):
        admit(code(loops), "a.py")
    doubling = "def f0(x):\n    return x + 1.0\n"
    for level in range(1, 40):
        doubling += f"def f{level}(x):\n    return f{level - 1}(x) + f{level - 1}(x)\n"
    with pytest.raises(RefusedCodeError, match="more than 15,000 operations"):
        admit(code("return f39(1.0)", doubling), "a.py")


@pytest.mark.parametrize(
    "body",
    [
        "return 10 ** 10 ** 10",
        "return np.power(10, np.power(10, 10))",
        "x = 3\nfor i in range(100):\n    x = x * x\nreturn x",
        "x = True + True\nfor i in range(100):\n    x = x * x\nreturn x",
        "x = sum((True, True, True))\nfor i in range(100):\n    x = x * x\nreturn x",
        "x = np.array((3, 5))\nfor i in range(100):\n    x = np.square(x)\nreturn x[0]",
        "x = step.obs\nfor i in range(60):\n    x = np.array((x, x))\nreturn np.sum(x)",
        "x = step.obs\nfor i in range(60):\n    x = np.abs([x, x])\nreturn np.sum(x)",
        "x = (1, 2)\nfor i in range(60):\n    x = (x, x)\nreturn np.sum(x)",
        "x = (1, 2)\nfor i in range(60):\n    x = x + x\nreturn np.sum(x)",
        "return np.sum((1, 2) * 1000000000)",
        "i = 1\nfor j in range(3):\n    i = i + 1\nreturn sum([0] * i)",
        "return (-8.0) ** 0.5",
        "return np.array(step)",
        "return step",
        "return abs(step)",
        "return (step,)",
        "return 1 / 0",
        "return math.exp(1e9)",
        "if step.hand:\n    return 1.0\nreturn 0.0",
    ],
)
def test_what_only_running_shows(body):
    """Numbers and arrays that would grow without end become an error of the prior at once, as all its mistakes do."""
    function = admit(code(body), "a.py").function()
    with np.errstate(all="ignore"), pytest.raises(PriorError):
        evaluate_prior(function, random_step("button-press", np.random.default_rng(0)), "x")


def test_constants_stay_as_they_are():
    """Adding to a variable never changes the array that a constant of the file holds: priors have no memory."""
    function = admit(code("x = W\nx += 1.0\nreturn np.sum(x)", "W = np.array([1.0, 2.0])"), "a.py").function()
    step = random_step("button-press", np.random.default_rng(0))
    assert [float(function(step)) for _ in range(3)] == [5.0] * 3


def test_nothing_of_python_is_within_reach():
    """The code's globals are the vocabulary; it has no builtins, and `import` finds no `__import__`."""
    room = namespace()
    assert room["__builtins__"] == {}
    assert set(room) == {"__builtins__", VALUE, *SIGNATURES, *OPERATIONS} | {
        n for n in room if isinstance(room[n], float)
    }
    assert set(SIGNATURES) == set(FUNCTIONS)
    with pytest.raises(ImportError):
        exec("import os", room)


def test_annotations_are_not_evaluated():
    """A model may annotate; whatever stands there is dropped."""
    text = "def reward(step: print('!')) -> exit():\n    x: exec('1') = 2.0\n    return x\n"
    assert admit(text.encode(), "a.py").function()(None) == 2.0


NAMES = [
    "step",
    "x",
    "np",
    "math",
    "reward",
    "f",
    "__import__",
    "getattr",
    "W",
    "i",
    "ｎｐ",
    "row",
    "operator Add",
    "abs",
]
ATTRIBUTES = [
    "hand",
    "obs",
    "first",
    "rng",
    "info",
    "exp",
    "load",
    "__class__",
    "linalg",
    "norm",
    "T",
    "pi",
    "dot",
    "sum",
]


@st.composite
def expressions(draw, depth=4):
    """Expressions out of names that mean something, allowed and forbidden alike."""
    inner = expressions(depth - 1) if depth else st.sampled_from(NAMES)
    shape = draw(st.sampled_from(
        ["{a}", "{n}", "{a}.{t}", "{n}.{t}", "{a}({b})", "{n}({a})", "{n}.{t}({a}, {b})", "{a}[{i}]", "({a} + {b})",
         "({a} ** {b})", "({a} * {b})", "({a}, {b})", "[{a}, {b}]", "({a} if {b} else {a})", "({a} < {b})", "(-{a})",
         "{v}", "(lambda x: {a})", "[x for x in {a}]", "f'{{{a}}}'", "(x := {a})", "(not {a})", "({a} and {b})",
         "{n}({a}, out={b})", "(*{a},)"]
    ))  # fmt: skip
    return shape.format(
        a=draw(inner), b=draw(inner), n=draw(st.sampled_from(NAMES)), t=draw(st.sampled_from(ATTRIBUTES)),
        i=draw(st.sampled_from(["0", "-1", ":2", "i", "x", "None"])), v=draw(st.sampled_from(["1", "2.5", "''"])),
    )  # fmt: skip


def instructions(code):
    """What a code object and those inside it do: operation, argument, and the argument in words."""
    for part in dis.get_instructions(code):
        yield part.opname, part.arg, part.argrepr
        if isinstance(part.argval, CodeType):
            yield from instructions(part.argval)


@pytest.mark.slow
@settings(max_examples=300)
@given(expressions())
def test_whatever_is_admitted_is_harmless(expression):
    """Random code is refused, fails as a prior, or gives a number; what is run names only what it may."""
    source = code(
        f"x = 1.0\nfor i in range(3):\n    x = x + 1.0\nreturn {expression}", "W = 2.0\ndef f(x):\n    return x"
    )
    try:
        admitted = admit(source, "a.py")
    except RefusedCodeError:
        return
    known = {*namespace(), "step", "x", "i", "f", "W", "reward"} - {"__builtins__"}
    for name, _, text in instructions(admitted.code):
        assert not re.search(r"DEREF|CLOSURE|BINARY_OP|STORE_(ATTR|SUBSCR)|IMPORT|UNPACK_EX|FORMAT|YIELD", name)
        if re.search(r"LOAD_(NAME|GLOBAL|FAST)", name):
            assert text.removeprefix("NULL + ") in known
        if name in ("LOAD_ATTR", "LOAD_METHOD"):
            assert text in ACCESSORS
    with np.errstate(all="ignore"):
        try:
            evaluate_prior(admitted.function(), random_step("button-press", np.random.default_rng(0)), "x")
        except RrmError:
            return


@pytest.mark.slow
@settings(max_examples=300)
@given(st.binary(max_size=300) | st.text(max_size=300).map(lambda text: text.encode(errors="replace")))
def test_any_bytes_are_read_or_refused(source):
    """No file, however strange, ends in anything but a refusal."""
    with pytest.raises(RefusedCodeError):
        admit(source, "a.py")
