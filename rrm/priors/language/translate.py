"""Code that a language model wrote becomes code that can be run: a syntax tree built anew from a small subset.

What is not translated does not exist: every node of the result is made here, and every name in it is the code's own or
one of `vocabulary`. The code always ends, in little memory: loops run over what is written out and functions call only
those above them, every statement and expression costs work, which is counted beforehand, and every value is checked for
what it is and how large.
"""

from __future__ import annotations

import ast
import traceback
import unicodedata
import warnings
from collections import ChainMap
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from types import CodeType
from typing import Any, Literal

from rrm.errors import RefusedCodeError
from rrm.priors.language.vocabulary import ACCESSORS, CONSTANTS, OPERATORS, SIGNATURES, VALUE

ENTRY = "reward"  #: the function that is the prior
MOST_WORK = 15_000  #: statements, expressions and bindings that one call takes, counted through loops and calls

_LONGEST = 20_000  # characters of a file, without lines of comment: a record grows with its candidates
_DEEPEST = 60  # levels of the syntax tree
_MOST_FUNCTIONS = 32  # each calls those above it, so that many calls are open at once
_MOST_TURNS = 100  # of one loop
_MOST_ITEMS = 32  # of a tuple, list or call
_LARGEST = 1e9  # number written out
_COMPARISONS = (ast.Lt, ast.LtE, ast.Gt, ast.GtE, ast.Eq, ast.NotEq)

#: Of a name. Only a `counter` is sure to be an integer; nothing else can be bound to its name.
_NameKind = Literal["word", "module", "constant", "function", "variable", "counter"]


@dataclass(frozen=True)
class Admitted:
    """Code within the subset."""

    code: CodeType
    reads: frozenset[str]  #: of `vocabulary.ACCESSORS`, what it looks at
    where: str  #: file, for messages

    def function(self) -> Callable[[Any], float]:
        """The prior, ready to be called with a `PriorStep`; refused where one of its constants cannot be computed."""
        from rrm.priors.language.guards import namespace  # numpy, which planning does without

        room = namespace()
        try:
            exec(self.code, room)  # noqa: S102  (it is what we made)
        except Exception as error:
            where = f"{self.where}, line {traceback.extract_tb(error.__traceback__)[1].lineno}"
            raise RefusedCodeError(f"{where}: {type(error).__name__} in a constant: {error}") from error
        entry: Callable[[Any], float] = room[ENTRY]
        return entry


@lru_cache  # planning asks for every run
def admit(source: bytes, where: str) -> Admitted:
    """Check the code of a whole file, without running it.

    A `RefusedCodeError` names the file (`where`), the line, and the construct that the subset does not have.
    """
    try:
        with warnings.catch_warnings(action="ignore"):  # of the parser, about texts that are dropped
            translator = _Translator(where, _text(source, where))
            code = compile(translator.module(), where, "exec", dont_inherit=True)  # refuses loops within twenty others
    except SyntaxError as error:
        raise RefusedCodeError(f"{where}, line {error.lineno}: {error.msg}") from None
    except (RecursionError, MemoryError):  # of the parser, which cannot say where
        raise RefusedCodeError(f"{where}: nested too deeply") from None
    if ENTRY not in translator.work:
        raise RefusedCodeError(f"{where}: no function {ENTRY}(step)")
    return Admitted(code, frozenset(translator.reads), where)


def _text(source: bytes, where: str) -> str:
    try:
        text = source.decode()
    except UnicodeDecodeError:
        raise RefusedCodeError(f"{where}: not UTF-8 text") from None
    length = 0
    for number, line in enumerate(text.split("\n"), start=1):
        length += 0 if line.startswith("#") else len(line)
        if length > _LONGEST:
            raise RefusedCodeError(f"{where}, line {number}: more than {_LONGEST:,} characters of code")
        if any(unicodedata.category(sign).startswith("C") and sign not in "\t\r" for sign in line):
            raise RefusedCodeError(f"{where}, line {number}: an invisible character")
    return text


class _Translator:
    """Rebuilds one file; what has no case of its own is refused. On the way names are bound and work is counted."""

    def __init__(self, where: str, text: str) -> None:
        self.reads: set[str] = set()  # accessors of the step
        self.work: dict[str, int] = {}  # of one call, for each function so far
        self._where, self._text = where, text
        self._modules: dict[str, str] = {}  # alias -> numpy or math
        self._names: ChainMap[str, _NameKind] = ChainMap(dict.fromkeys((*SIGNATURES, "range"), "word"))
        self._inside = False  # a function
        self._spent, self._turns = 0, 1

    def module(self) -> ast.Module:
        level: list[ast.AST] = [tree := ast.parse(self._text)]
        for _ in range(_DEEPEST):
            level = [child for node in level for child in ast.iter_child_nodes(node) if child._fields]
        if level:
            line = max(getattr(node, "lineno", 1) for node in level)
            raise RefusedCodeError(f"{self._where}, line {line}: nested too deeply")
        body: list[ast.stmt] = []
        for node in tree.body:
            match node:
                case ast.Import(names):
                    for alias in names:
                        if alias.name not in ("numpy", "math"):
                            raise self._refused(node, "only numpy and math can be imported")
                        name = alias.asname or alias.name
                        self._bind(name, "module", node)
                        self._modules[name] = alias.name
                case ast.Assign(targets=[ast.Name()]):
                    body += self._block([node])
                case ast.FunctionDef():
                    body.append(self._function(node))
                case _ if not is_text(node):
                    raise self._refused(node, "outside functions stand imports, constants and functions")
        return ast.fix_missing_locations(ast.Module(body, []))

    def _function(self, node: ast.FunctionDef) -> ast.FunctionDef:
        given = node.args
        if node.decorator_list:
            raise self._refused(node.decorator_list[0], "functions have no decorators")
        if given.posonlyargs or given.kwonlyargs or given.vararg or given.kwarg:
            raise self._refused(node, f"{node.name}: parameters are plain names", short=True)
        if node.name == ENTRY and (len(given.args) != 1 or given.defaults):
            raise self._refused(node, f"{ENTRY} has one parameter, the step", short=True)
        for default in given.defaults:
            if not isinstance(default, ast.Constant):
                raise self._refused(default, "defaults are numbers")
        defaults = [self._expression(default) for default in given.defaults]
        if len(self.work) == _MOST_FUNCTIONS:
            raise self._refused(node, f"{_MOST_FUNCTIONS} functions are the most", short=True)
        self._bind(node.name, "function", node)
        before, self._spent, self._inside, self._names = self._spent, 0, True, self._names.new_child()
        for arg in given.args:
            self._bind(arg.arg, "variable", arg)
        body = self._block(node.body)
        self.work[node.name] = self._spent
        self._spent, self._inside, self._names = before, False, self._names.parents
        # Annotations are left out: nothing evaluates them, and what they bind is not bound.
        parameters = [ast.copy_location(ast.arg(arg.arg), arg) for arg in given.args]
        arguments = ast.arguments([], parameters, None, [], [], None, defaults)
        return ast.copy_location(ast.FunctionDef(node.name, arguments, body, []), node)

    def _block(self, statements: list[ast.stmt]) -> list[ast.stmt]:
        """At least one statement; each costs work, so that a loop around nothing is not free."""
        rebuilt = []
        kept = [node for node in statements if not is_text(node)]
        for node in kept or [ast.copy_location(ast.Pass(), statements[0])]:
            self._spend(1, node)
            rebuilt.append(ast.copy_location(self._statement(node), node))
        return rebuilt

    def _statement(self, node: ast.stmt) -> ast.stmt:  # noqa: PLR0911  (the table of all there is)
        match node:
            case ast.Pass() | ast.Break() | ast.Continue():
                return type(node)()  # whether there is a loop around it, the compiler sees
            case ast.Return(value=ast.expr() as value):
                return ast.Return(self._expression(value))
            case ast.Return():
                raise self._refused(node, "a function returns a value")
            case ast.Assign(targets, value):
                return self._assign(targets, value)
            case ast.AnnAssign(target=target, value=ast.expr() as value):
                return self._assign([target], value)
            case ast.AnnAssign():
                raise self._refused(node, "an annotation without a value")
            case ast.AugAssign(target, op, value):
                # Not in place: an array that a constant holds must stay as it is.
                return self._assign([target], ast.copy_location(ast.BinOp(target, op, value), node))
            case ast.If(test, body, orelse):
                return ast.If(self._expression(test), self._block(body), self._block(orelse) if orelse else [])
            case ast.For():
                return self._loop(node)
        raise self._refused(node, "this kind of statement is not allowed")

    def _assign(self, targets: list[ast.expr], value: ast.expr) -> ast.stmt:
        new = self._expression(value)
        return ast.Assign([self._target(target) for target in targets], new)

    def _loop(self, node: ast.For) -> ast.For:
        """Over what its variable stands for in each turn, written out."""
        if node.orelse:
            raise self._refused(node.orelse[0], "a loop has no else")
        items: list[ast.expr]
        kind: _NameKind = "variable"
        match node.iter:
            case ast.Tuple(elts=parts) | ast.List(elts=parts):
                items = self._items(parts, node.iter)
            case ast.Call(func=ast.Name(id="range"), args=[*bounds], keywords=[]) if len(bounds) in (1, 2):
                turns = range(*map(self._bound, bounds))
                if len(turns) > _MOST_TURNS:
                    raise self._refused(node.iter, f"a loop takes at most {_MOST_TURNS} turns")
                items, kind = [ast.Constant(turn) for turn in turns], "counter"
            case _:
                raise self._refused(node.iter, "loops run over range(number) or over a tuple that is written out")
        target = self._target(node.target, kind)
        before, self._turns = self._turns, self._turns * len(items)
        self._spend(1, node)
        body = self._block(node.body)
        self._turns = before
        return ast.For(target, ast.Tuple(items, ast.Load()), body, [])

    def _bound(self, node: ast.expr) -> int:
        if not isinstance(node, ast.Constant) or type(node.value) is not int or node.value > 1e6:
            raise self._refused(node, "the bounds of range are numbers")
        return node.value

    def _target(self, node: ast.expr, kind: _NameKind = "variable") -> ast.expr:
        match node:
            case ast.Name(id=name):
                self._spend(1, node)
                self._bind(name, kind if self._inside else "constant", node)
                return ast.copy_location(ast.Name(name, ast.Store()), node)
            case ast.Tuple(elts=parts) if all(isinstance(part, ast.Name) for part in parts):
                return ast.copy_location(ast.Tuple([self._target(part) for part in parts], ast.Store()), node)
        raise self._refused(node, "only names can be assigned to")

    def _expression(self, node: ast.expr) -> ast.expr:
        """The expression, rebuilt, counted, and with a check around what it gives."""
        self._spend(1, node)
        new = ast.copy_location(self._rebuilt(node), node)
        if isinstance(new, ast.Constant | ast.Name):  # numbers that are written out, and what has been checked already
            return new
        return ast.copy_location(_called(VALUE, [new]), node)

    def _items(self, nodes: list[ast.expr], whole: ast.expr) -> list[ast.expr]:
        if len(nodes) > _MOST_ITEMS:
            raise self._refused(whole, f"{len(nodes)} items; {_MOST_ITEMS} are the most")
        return [self._expression(node) for node in nodes]

    def _rebuilt(self, node: ast.expr) -> ast.expr:  # noqa: PLR0911, PLR0912  (the table of all there is)
        match node:
            case ast.Constant(value=bool() | int() | float() as value):
                if not abs(value) <= _LARGEST:
                    raise self._refused(node, f"numbers are {_LARGEST:,.0f} at the most")
                return ast.Constant(float(value))
            case ast.Constant():
                raise self._refused(node, "values that can be written are numbers, True and False")
            case ast.Name(id=name):
                if self._names.get(name) not in ("constant", "variable", "counter"):
                    raise self._refused(node, "not a parameter, variable or constant of this code, up to here")
                return ast.Name(name, ast.Load())
            case ast.Attribute(value=value, attr=name):
                return self._attribute(node, value, name)
            case ast.BinOp(left, op, right):
                if type(op).__name__ not in OPERATORS:
                    raise self._refused(node, "operators are + - * / // % **")
                return _called(f"operator {type(op).__name__}", [self._expression(left), self._expression(right)])
            case ast.UnaryOp(op, operand):
                if not isinstance(op, ast.USub | ast.UAdd | ast.Not):
                    raise self._refused(node, "signs are + - not")
                return ast.UnaryOp(op, self._expression(operand))
            case ast.BoolOp(op, values):
                return ast.BoolOp(op, self._items(values, node))
            case ast.Compare(left, ops, others):
                if not all(isinstance(op, _COMPARISONS) for op in ops):
                    raise self._refused(node, "comparisons are < <= > >= == !=")
                return ast.Compare(self._expression(left), ops, self._items(others, node))
            case ast.IfExp(test, body, orelse):
                return ast.IfExp(self._expression(test), self._expression(body), self._expression(orelse))
            case ast.Subscript(value=value, slice=index):
                return ast.Subscript(self._expression(value), self._index(index), ast.Load())
            case ast.Tuple(elts=parts) | ast.List(elts=parts):
                return ast.Tuple(self._items(parts, node), ast.Load())
            case ast.Call():
                return self._call(node)
        raise self._refused(node, "this kind of expression is not allowed")

    def _attribute(self, node: ast.Attribute, value: ast.expr, name: str) -> ast.expr:
        path = self._path(node)
        if path is not None:
            if path not in CONSTANTS:
                raise self._refused(node, "not a constant of numpy or math that can be used here")
            return ast.Name(path, ast.Load())
        if name not in ACCESSORS:
            raise self._refused(node, f"what can be read, of the step, is {', '.join(sorted(ACCESSORS))}")
        self.reads.add(name)
        return ast.Attribute(self._expression(value), name, ast.Load())

    def _call(self, node: ast.Call) -> ast.expr:
        name = (node.func.id if isinstance(node.func, ast.Name) else self._path(node.func)) or ""
        words = {word.arg: word.value for word in node.keywords if word.arg is not None}
        if name in self.work and self._inside:
            self._spend(self.work[name], node)
        elif name not in SIGNATURES:
            raise self._refused(node.func, "not a function that can be called here; of the code's own, those above can")
        elif len(node.args) > SIGNATURES[name].most or not words.keys() <= SIGNATURES[name].keywords:
            raise self._refused(node, f"{name} takes at most {SIGNATURES[name].most} plain arguments here")
        if len(words) < len(node.keywords):
            raise self._refused(node, "arguments are written out")
        keywords = [ast.keyword(word, self._expression(value)) for word, value in words.items()]
        return ast.Call(ast.Name(name, ast.Load()), self._items(node.args, node), keywords)

    def _path(self, node: ast.expr) -> str | None:
        """`numpy.linalg.norm` for what `np.linalg.norm` says; None for what has no module at its root."""
        match node:
            case ast.Name(id=name):
                return self._modules.get(name)
            case ast.Attribute(value=value, attr=name) if root := self._path(value):
                return f"{root}.{name}"
        return None

    def _index(self, node: ast.expr) -> ast.expr:
        """A number, a loop's counter, or a slice between numbers: integers that stay integers."""
        match node:
            case ast.Slice(lower=lower, upper=upper, step=None):
                return ast.Slice(*(None if end is None else self._index(end) for end in (lower, upper)))
            case ast.Constant() if type(node.value) is int and node.value < _LARGEST:
                return ast.Constant(node.value)
            case ast.UnaryOp(op=ast.USub(), operand=ast.Constant() as operand):
                return ast.UnaryOp(ast.USub(), self._index(operand))
            case ast.Name(id=name) if self._names.get(name) == "counter":
                return ast.Name(name, ast.Load())
        raise self._refused(node, "an index is a number, a slice of numbers or the counter of a range loop")

    def _spend(self, work: int, node: ast.AST) -> None:
        """Count work of one execution of the node."""
        self._spent += work * self._turns
        if self._spent > MOST_WORK:
            raise self._refused(node, f"one call would take more than {MOST_WORK:,} operations")

    def _bind(self, name: str, kind: _NameKind, node: ast.AST) -> None:
        """Give a name to something: once in a file; in a function again to the same kind, also to hide a constant."""
        if name.startswith("__"):
            raise self._refused(node, f"{name} begins with two underscores", short=True)
        bound = self._names.get(name)
        if bound is not None and not (self._inside and bound in (kind, "constant")):
            raise self._refused(node, f"{name} is a {bound} already; give this another name", short=True)
        self._names[name] = kind

    def _refused(self, node: ast.AST, why: str, *, short: bool = False) -> RefusedCodeError:
        """The error for code that goes too far, with its line; `short` where it is as long as a whole function."""
        text = "" if short else " ".join((ast.get_source_segment(self._text, node) or "").split())
        shown = f"`{text if len(text) <= 60 else text[:57] + '...'}` ({type(node).__name__}): " if text else ""
        return RefusedCodeError(f"{self._where}, line {getattr(node, 'lineno', '?')}: {shown}{why}")


def _called(name: str, arguments: list[ast.expr]) -> ast.Call:
    return ast.Call(ast.Name(name, ast.Load()), arguments, [])


def is_text(node: ast.stmt) -> bool:
    """A docstring, or a text that stands alone: nothing happens there."""
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
