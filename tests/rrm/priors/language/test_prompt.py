"""The prompt: the environment's source as installed, and nothing of its reward."""

import ast
import difflib
import importlib
import inspect
import re
import sys
from pathlib import Path

import numpy as np
import pytest

from rrm.envs import make, task
from rrm.errors import ConfigError
from rrm.priors.language import language
from rrm.priors.language.prompt import make_prompt, source_without_reward, without_reward

pytestmark = pytest.mark.sim

every_task = pytest.mark.parametrize("name", sorted(language.tasks))

#: Accessors that a reward calls and that the paper's prompt shows: what can be measured, not what it is worth.
MEASUREMENTS = {
    "torso_upright", "torso_height", "horizontal_velocity", "torso_velocity", "get_observation", "orientations",
    "_common_observations", "egocentric_state", "force_torque", "imu", "_get_sensor_names", "_get_pos_objects",
    "_get_quat_objects", "clearance", "drive", "observe", "_outside", "_speed", "_square", "after_step", "before_step",
    "_get_id_main_object", "_target_site_config",
}  # fmt: skip


def environment_module(name):
    """The module whose file the prompt shows, by way of the environment that is really run."""
    env = make(name)
    try:
        if name == "toy-car":
            return sys.modules[type(env).__module__]
        sim = env.sim
        return sys.modules[type(sim.task if task(name).suite == "dmc" else sim).__module__]
    finally:
        env.close()


def functions_run(name, module):
    """Names of the module's functions that run during steps of the environment: all of its reward is among them."""
    env, ran = make(name), set()

    def trace(frame, event, _):
        if event == "call" and frame.f_code.co_filename == module.__file__:
            ran.add(frame.f_code.co_name)

    env.reset(seed=0)
    before = sys.gettrace()
    sys.settrace(trace)
    try:
        for act in np.random.default_rng(0).uniform(-1, 1, (5, *env.action_space.shape)).astype(np.float32):
            env.step(act)
    finally:
        sys.settrace(before)
        env.close()
    return ran


@every_task
def test_no_reward_is_left(name):
    """Of all that runs in a step only measurements are shown; the word itself does not occur."""
    text = source_without_reward(task(name))
    assert "reward" not in text.lower()
    module = environment_module(name)
    ran = functions_run(name, module)
    assert ran - MEASUREMENTS, "the true reward must have run"
    shown = {node.name for node in ast.walk(ast.parse(text)) if isinstance(node, ast.FunctionDef)}
    assert ran & shown <= MEASUREMENTS


@every_task
def test_no_formula_of_a_reward_is_left(name):
    """No statement of a function that takes part in the reward stands anywhere in what is shown."""
    source = inspect.getsource(environment_module(name))
    rewarding = [
        node for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.FunctionDef) and ("reward" in node.name or node.name == "evaluate_state")
    ]  # fmt: skip
    assert rewarding
    formulas = {
        ast.dump(inner.value) for node in rewarding for inner in ast.walk(node)
        if isinstance(inner, ast.Assign | ast.Return | ast.AugAssign | ast.AnnAssign) and inner.value is not None
        and sum(isinstance(part, ast.BinOp | ast.Call | ast.Compare) for part in ast.walk(inner.value)) > 1
    }  # fmt: skip
    shown = {
        ast.dump(node) for node in ast.walk(ast.parse(source_without_reward(task(name)))) if isinstance(node, ast.expr)
    }
    assert formulas
    assert not formulas & shown


@every_task
def test_the_rest_is_verbatim(name):
    """Every line that is shown is a line of the installed file, in its order; observation and reset are there."""
    module = environment_module(name)
    lines = Path(module.__file__).read_text().splitlines()
    shown = source_without_reward(task(name)).splitlines()
    matched = difflib.SequenceMatcher(None, lines, shown, autojunk=False).get_matching_blocks()
    left_over = [line for line in shown if line and line not in lines]
    assert left_over == []
    assert sum(block.size for block in matched) >= len(shown) - shown.count("")
    kept = {"metaworld": "def reset_model", "dmc": "def get_observation", "toy": "def observe"}[
        task(name).suite.removesuffix("-image")
    ]
    assert kept in "\n".join(shown)


def test_walker_as_in_the_paper():
    """First line, constants, accessors and instruction of the prompt that the paper prints."""
    text = make_prompt(task("walker-walk"), skeleton=False)
    assert text.startswith(
        "Here is a DM-control (built on MuJoCo) task: Walker Walk. The robot Walker is required to walk normally. "
        "The environment code is:\n"
    )
    assert text.endswith("\nPlease design a reward for this task to enable the agent to achieve the goal.\n")
    for shown in (
        "_STAND_HEIGHT = 1.2",
        "_WALK_SPEED = 1",
        "def torso_upright",
        "def horizontal_velocity",
        "obs['height']",
    ):
        assert shown in text
    assert "tolerance" not in text
    assert "stand_reward" not in text


@every_task
def test_skeleton(name):
    """The skeleton names what the task reveals, and nothing else, and its code is Python."""
    spec = task(name)
    paper, text = make_prompt(spec, skeleton=False), make_prompt(spec, skeleton=True)
    assert text.startswith(paper.rstrip())
    told = set(re.findall(r"^ +step\.(\w+):", text[len(paper) :], re.MULTILINE))
    assert told == {*spec.features, *spec.outcomes, "obs", "act", "first"} - {"proprioception"}  # has no property
    ast.parse(
        re.search(r"^import numpy as np\n\n\ndef reward.*?    \.\.\.\n", text[len(paper) :], re.DOTALL | re.MULTILINE)[
            0
        ]
    )


@pytest.mark.parametrize(
    ("source", "left"),
    [
        ("import rewards, os\nx = 1\n", "x = 1\n"),
        ("def f(a, reward=1, *, b):\n    return a\n", "def f(a, *, b):\n    return a\n"),
        ("def f(\n    a,\n    reward: int = 2,\n):\n    return a\n", "def f(\n    a,\n):\n    return a\n"),
        ("class A:\n    def get_reward(self):\n        return 1\n    x = 2\n", "class A:\n    x = 2\n"),
        ("class A:\n    '''Text.'''\n    def get_reward(self):\n        return 1\n\ny = 1\n", "y = 1\n"),
        ("@mark(1)\n@other\ndef reward():\n    return 1\ny = 1\n", "y = 1\n"),
        ("def step():\n    r = compute()\n    return obs, {'Reward': r}\ny = 1\n", "y = 1\n"),
        ("if x:\n    reward = 1\nelse:\n    y = 2\n    reward = 3\n", None),
        ("if x:\n    reward = 1\ny = 1\n", "y = 1\n"),
        ("while reward:\n    y = 2\ny = 1\n", "y = 1\n"),
        ("for a in b:\n    y = 2\n    self.reward = 3\n", "for a in b:\n    y = 2\n"),
        ("def f():\n    '''The reward.'''\n    return 1\n", "def f():\n    return 1\n"),
        ("x = 1  # the reward\n# reward\ny = 'ä'  # fine\n", "x = 1\ny = 'ä'  # fine\n"),
        ("α = 1; β = 2\nclass Reward:\n    x = 1\n", None),
    ],
)  # fmt: skip
def test_what_goes(source, left):
    """Parameters, statements, comments, functions, and blocks that would be empty; what cannot be cut is refused."""
    if left is None:
        with pytest.raises(ConfigError, match="its reward cannot be taken out"):
            without_reward(source, "x.py")
    else:
        assert without_reward(source, "x.py") == left


def test_only_tasks_with_a_prompt(monkeypatch):
    """Another task is told which ones there are; a package that is missing is named."""
    from dataclasses import replace

    other = replace(task("toy-car"), name="other")
    for ask in (lambda: make_prompt(other, skeleton=True), lambda: source_without_reward(other)):
        with pytest.raises(
            ConfigError, match=r"no prompt for other; there is one for: button-press, .*, sweep-into-image$"
        ):
            ask()
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ConfigError, match="metaworld is not installed"):
        source_without_reward(task("button-press"))
