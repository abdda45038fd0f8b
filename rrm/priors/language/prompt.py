"""The prompt for a language model: a line on the task, the environment's source, an instruction (paper, appendix).

The source is the file of the installed package, verbatim, without its reward. What goes, by the syntax tree: functions
whose name speaks of a reward, functions that return what does, and elsewhere the single parameters, statements,
docstrings and comments that mention one. What stays is not touched.

The paper's prompt stops there and its answers are transcribed by hand; the skeleton is the code that an answer is to
fill in, as the appendix suggests, with what a prior may read and the subset of Python that is admitted.
"""

from __future__ import annotations

import ast
import importlib.util
import io
import re
import tokenize
from collections.abc import Iterator
from itertools import accumulate
from pathlib import Path

from rrm.envs.tasks import TASKS, Task
from rrm.errors import ConfigError
from rrm.priors.language.translate import is_text
from rrm.priors.language.vocabulary import OUTCOMES, TASK_FEATURES
from rrm.priors.step import PriorStep

#: Of Meta-World's tasks the file with the environment's class, and what the arm is to do.
_METAWORLD = {
    "button-press": ("sawyer_button_press_v3", "press a button in front of it"),
    "door-open": ("sawyer_door_v3", "open a door with a revolving joint by its handle"),
    "door-unlock": ("sawyer_door_unlock_v3", "unlock a door by turning its lock"),
    "sweep-into": ("sawyer_sweep_into_goal_v3", "sweep a puck on the table into a hole"),
    "window-open": ("sawyer_window_open_v3", "push a sliding window open by its handle"),
}

#: The file, from the folder that its package is installed in, and what the prompt's first line says of the task.
#: Walker-walk's is the paper's, the others follow it.
_TASKS = {
    **{
        name: (f"metaworld/envs/{file}.py", f"Meta-World (built on MuJoCo) task: {name.replace('-', ' ').title()}. "
        f"The robot arm Sawyer is required to {goal}.") for name, (file, goal) in _METAWORLD.items()
    },
    **{
        f"{robot.lower()}-walk": (f"dm_control/suite/{robot.lower()}.py", "DM-control (built on MuJoCo) task: "
        f"{robot} Walk. The robot {robot} is required to walk normally.") for robot in ("Walker", "Quadruped")
    },
    "toy-car": ("rrm/envs/toy_car.py", "two-dimensional task: Toy Car. The car is required to drive to a goal quickly, "
    "without coming too close to the obstacles."),
}  # fmt: skip

_INSTRUCTION = "Please design a reward for this task to enable the agent to achieve the goal."

_SKELETON = '''\
Please fill in this function. It is called once for every step, and returns one number, at best between -1 and 1.

import numpy as np


def reward(step):
    """The reward of one step.

    Before the step, float arrays or numbers:
{before}
{after}    step.first: the state the episode began with, with the same names.
    """
    ...

Use arithmetic, comparisons, if and for over a range of numbers, functions of numpy and math on numbers and small
arrays, and functions of your own above this one. Nothing else can be imported, and there are no methods,
comprehensions, classes or texts.
'''

_WORD = "reward"


def make_prompt(task: Task, *, skeleton: bool) -> str:
    """The prompt for this task, with the skeleton of an answer at its end or without.

    A `ConfigError` where there is none, its package is missing, or its reward cannot be taken out.
    """
    source = source_without_reward(task).rstrip("\n")
    prompt = f"Here is a {_TASKS[_shown(task)][1]} The environment code is:\n\n{source}\n\n{_INSTRUCTION}\n"
    if not skeleton:
        return prompt
    described = {name: f"    step.{name}: {getattr(PriorStep, name).__doc__}" for name in (*TASK_FEATURES, *OUTCOMES)}
    features = [described[name] for name in TASK_FEATURES if name in task.features]
    obs = f"    step.obs: the observation, {task.spaces.obs} numbers."
    act = f"    step.act: the action, {task.spaces.act} numbers."
    outcomes = [described[name] for name in OUTCOMES if name in task.outcomes]
    after = "\n".join(["", "    After the step, numbers:", *outcomes, ""]) if outcomes else ""
    before = "\n".join([*features, obs, act])
    return f"{prompt}\n{_SKELETON.format(before=before, after=after)}"


def _shown(task: Task) -> str:
    """The task whose source it is: a camera changes nothing of that."""
    return task.expert or task.name


def source_without_reward(task: Task) -> str:
    """The task's source file without its reward."""
    if _shown(task) not in _TASKS:
        known = ", ".join(name for name, each in TASKS.items() if _shown(each) in _TASKS)
        raise ConfigError(f"there is no prompt for {task.name}; there is one for: {known}")
    package, _, inside = _TASKS[_shown(task)][0].partition("/")
    spec = importlib.util.find_spec(package)  # found, not imported: simulators take a second to load
    if spec is None or not spec.submodule_search_locations:
        raise ConfigError(f"{package} is not installed; `rrmctl doctor` says how to")
    path = Path(spec.submodule_search_locations[0]) / inside
    try:
        return without_reward(path.read_text(encoding="utf-8"), str(path))
    except OSError as error:
        raise ConfigError(f"cannot read {path}: {error.strerror}") from error


def without_reward(source: str, where: str) -> str:
    """Python code without the parts that compute a reward or mention one; a `ConfigError` where that fails."""
    data, kept, at = source.encode(), [], 0
    for begin, end in sorted(_spans(source, data)):
        if begin >= at:  # else inside a span that is gone
            kept.append(data[at:begin])
        at = max(at, end)
    text = b"".join([*kept, data[at:]]).decode()
    text = re.sub(r"[ \t]+\n", "\n", text)
    text = re.sub(r"\n{4,}", "\n\n\n", text).strip() + "\n"
    try:
        ast.parse(text)
    except SyntaxError as error:
        why = f"line {error.lineno}: {error.msg}"
        raise ConfigError(f"{where}: its reward cannot be taken out cleanly ({why})") from None
    if _WORD in text.lower():
        line = next(line for line in text.splitlines() if _WORD in line.lower())
        raise ConfigError(f"{where}: its reward cannot be taken out; this is left: {line.strip()}")
    return text


def _spans(source: str, data: bytes) -> Iterator[tuple[int, int]]:
    """What goes: statements with their whole lines, parameters with their comma, comments, alone with their line."""
    starts = [0, *accumulate(map(len, data.splitlines(keepends=True)))]  # of lines; the parser counts columns in bytes
    for node in _doomed(ast.parse(source).body):
        assert isinstance(node, ast.stmt | ast.arg)
        assert node.end_lineno is not None
        assert node.end_col_offset is not None
        if isinstance(node, ast.stmt):
            first = min([node.lineno, *(mark.lineno for mark in getattr(node, "decorator_list", []))])
            yield starts[first - 1], starts[node.end_lineno]
            continue
        line = starts[node.lineno - 1]
        begin = line + node.col_offset
        end = starts[node.end_lineno - 1] + node.end_col_offset
        rest = re.compile(rb"\s*(=[^,()]*)?,?[ \t]*\n?").match(data, end)
        assert rest is not None  # the pattern matches nothing, too
        yield line if data[line:begin].isspace() else begin, rest.end()
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT and _WORD in token.string.lower():
            line, before = starts[token.start[0] - 1], token.line[: token.start[1]]
            begin, end = (line + len(token.line[:column].encode()) for column in (token.start[1], token.end[1]))
            yield (begin, end) if before.strip() else (line, end + 1)


def _doomed(body: list[ast.stmt]) -> Iterator[ast.AST]:
    """The largest parts to leave out, among statements that stand in one block."""
    for node in body:
        match node:
            case ast.FunctionDef() | ast.AsyncFunctionDef():
                returned = (part.value for part in ast.walk(node) if isinstance(part, ast.Return) and part.value)
                if _WORD in node.name.lower() or any(map(_mentions, returned)):
                    yield node
                    continue
                yield from filter(_mentions, [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs])
                yield from _block(node, node.body)
            case ast.ClassDef() | ast.With():
                yield from _block(node, node.body)
            case ast.If() | ast.For() | ast.While() if _mentions(node):
                head = node.iter if isinstance(node, ast.For) else node.test
                yield from [node] if _mentions(head) else _block(node, [*node.body, *node.orelse])
            case _ if _mentions(node):
                yield node


def _block(owner: ast.stmt, body: list[ast.stmt]) -> list[ast.AST]:
    """What goes from a block; all of it where nothing but a docstring would stay."""
    doomed = list(_doomed(body))
    left = [node for node in body if node not in doomed and not is_text(node)]
    return doomed if left or not doomed else [owner]


def _mentions(node: ast.AST) -> bool:
    """Whether a name of any kind or a text in the node speaks of a reward."""
    fields = (value for part in ast.walk(node) for _, value in ast.iter_fields(part))
    texts = (text for value in fields for text in (value if isinstance(value, list) else [value]))
    return any(isinstance(text, str) and _WORD in text.lower() for text in texts)
