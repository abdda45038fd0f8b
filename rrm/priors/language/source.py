"""A task's source as the prompt shows it: the file of the installed package, verbatim, without its reward.

What goes, by the syntax tree: functions whose name speaks of a reward, functions that return what does, and elsewhere
the single parameters, statements, docstrings and comments that mention one. What stays is not touched.
"""

from __future__ import annotations

import ast
import importlib.util
import io
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path

from rrm.envs.tasks import Task
from rrm.errors import ConfigError

_WORD = "reward"

#: The file with the class of a task's environment, from the folder that its package is installed in.
_FILES = {
    "button-press": "metaworld/envs/sawyer_button_press_v3.py",
    "door-open": "metaworld/envs/sawyer_door_v3.py",
    "door-unlock": "metaworld/envs/sawyer_door_unlock_v3.py",
    "sweep-into": "metaworld/envs/sawyer_sweep_into_goal_v3.py",
    "window-open": "metaworld/envs/sawyer_window_open_v3.py",
    "walker-walk": "dm_control/suite/walker.py",
    "quadruped-walk": "dm_control/suite/quadruped.py",
    "toy-car": "rrm/envs/toy_car.py",
}

Span = tuple[int, int]  #: of characters


def source_without_reward(task: Task) -> str:
    """The task's source file without its reward.

    Raises:
        ConfigError: the task has no prompt, its package is not installed, or a mention of a reward is left over.
    """
    if task.name not in _FILES:
        raise ConfigError(f"there is no prompt for {task.name}; there is one for: {', '.join(_FILES)}")
    package, _, inside = _FILES[task.name].partition("/")
    spec = importlib.util.find_spec(package)  # found, not imported: simulators take a second to load
    if spec is None or not spec.submodule_search_locations:
        raise ConfigError(f"{package} is not installed; `rrmctl doctor` says how to")
    path = Path(spec.submodule_search_locations[0]) / inside
    try:
        return without_reward(path.read_text(encoding="utf-8"), str(path))
    except OSError as error:
        raise ConfigError(f"cannot read {path}: {error.strerror}") from error


def without_reward(source: str, where: str) -> str:
    """Python code without the parts that compute a reward or mention one.

    Raises:
        ConfigError: something is left that mentions one, or what is left is not Python.
    """
    text = _cut(source, [*_code(source), *_comments(source)])
    text = re.sub(r"[ \t]+\n", "\n", text)
    text = re.sub(r"\n{4,}", "\n\n\n", text).strip() + "\n"
    try:
        ast.parse(text)
    except SyntaxError as error:
        raise ConfigError(
            f"{where}: its reward cannot be taken out cleanly (line {error.lineno}: {error.msg})"
        ) from None
    if _WORD in text.lower():
        line = next(line for line in text.splitlines() if _WORD in line.lower())
        raise ConfigError(f"{where}: its reward cannot be taken out; this is left: {line.strip()}")
    return text


def _cut(source: str, spans: list[Span]) -> str:
    kept, at = [], 0
    for begin, end in sorted(spans):
        if begin >= at:  # else inside a span that is gone
            kept.append(source[at:begin])
        at = max(at, end)
    return "".join([*kept, source[at:]])


def _code(source: str) -> list[Span]:
    places = _Places(source)
    return [_span(node, places) for node in _doomed(ast.parse(source).body)]


def _doomed(body: list[ast.stmt]) -> Iterator[ast.AST]:
    """The largest parts to leave out, among statements that stand in one block."""
    for node in body:
        match node:
            case ast.FunctionDef() | ast.AsyncFunctionDef() if _computes(node):
                yield node
            case ast.FunctionDef() | ast.AsyncFunctionDef():
                yield from (arg for arg in _parameters(node) if _mentions(arg))
                yield from _block(node, node.body)
            case ast.ClassDef() | ast.With():
                yield from _block(node, node.body)
            case ast.If() | ast.For() | ast.While() if _mentions(node):
                head = node.iter if isinstance(node, ast.For) else node.test
                rest = [*node.body, *node.orelse]
                yield from [node] if _mentions(head) else _block(node, rest)
            case _ if _mentions(node):
                yield node


def _block(owner: ast.stmt, body: list[ast.stmt]) -> list[ast.AST]:
    """What goes from a block; all of it where nothing but a docstring would stay."""
    doomed = list(_doomed(body))
    left = [node for node in body if node not in doomed and not _is_text(node)]
    return doomed if left or not doomed else [owner]


def _computes(function: ast.FunctionDef | ast.AsyncFunctionDef) -> bool:
    """Named after a reward, or returning what mentions one."""
    returned = (node.value for node in ast.walk(function) if isinstance(node, ast.Return) and node.value)
    return _WORD in function.name.lower() or any(map(_mentions, returned))


def _parameters(function: ast.FunctionDef | ast.AsyncFunctionDef) -> list[ast.arg]:
    return [*function.args.posonlyargs, *function.args.args, *function.args.kwonlyargs]


def _is_text(node: ast.stmt) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


def _mentions(node: ast.AST) -> bool:
    return any(_WORD in text.lower() for part in ast.walk(node) for text in _texts(part))


def _texts(node: ast.AST) -> Iterator[str]:
    """The words of a node itself: names of every kind, and texts."""
    for _, value in ast.iter_fields(node):
        yield from (part for part in (value if isinstance(value, list) else [value]) if isinstance(part, str))


class _Places:
    """Where lines begin, to turn lines and columns (in bytes, as the parser counts them) into characters."""

    def __init__(self, source: str) -> None:
        self.source = source
        self.lines = re.findall(r"[^\n]*\n|[^\n]+", source)  # the parser's lines; `splitlines` knows more ends
        self.starts = [0]
        for line in self.lines:
            self.starts.append(self.starts[-1] + len(line))

    def at(self, line: int, byte: int) -> int:
        return self.starts[line - 1] + len(self.lines[line - 1].encode()[:byte].decode())


def _span(node: ast.AST, places: _Places) -> Span:
    """From the node's first character to its last; statements with their whole lines, parameters with their comma."""
    assert isinstance(node, ast.stmt | ast.arg)
    assert node.end_lineno is not None
    assert node.end_col_offset is not None
    if isinstance(node, ast.stmt):
        first = min([node.lineno, *(mark.lineno for mark in getattr(node, "decorator_list", []))])
        return places.starts[first - 1], places.starts[node.end_lineno]
    line, begin = places.starts[node.lineno - 1], places.at(node.lineno, node.col_offset)
    rest = re.compile(r"\s*(=[^,()]*)?,?[ \t]*\n?").match(
        places.source, places.at(node.end_lineno, node.end_col_offset)
    )
    assert rest is not None  # the pattern matches nothing, too
    return line if places.source[line:begin].isspace() else begin, rest.end()


def _comments(source: str) -> list[Span]:
    places = _Places(source)
    tokens = tokenize.generate_tokens(io.StringIO(source).readline)
    spans = []
    for token in tokens:
        if token.type == tokenize.COMMENT and _WORD in token.string.lower():
            line = places.starts[token.start[0] - 1]
            alone = not token.line[: token.start[1]].strip()
            spans.append((line if alone else line + token.start[1], line + token.end[1] + alone))
    return spans
