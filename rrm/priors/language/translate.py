"""Code that a language model wrote becomes code that can be run: a syntax tree built anew from a small subset.

What is not translated does not exist: every node of the result is made here, and every name in it is the code's own or
one of `words`. The code always ends, in little memory: loops run over what is written out and functions call only those
above them, every statement and expression costs work, which is counted beforehand, and every value is checked for size.
"""

from __future__ import annotations

import ast
import traceback
import unicodedata
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, singledispatchmethod
from types import CodeType
from typing import Any

from rrm.errors import RefusedCodeError
from rrm.priors.language.expressions import Expressions
from rrm.priors.language.scope import Scope, ValueKind

ENTRY = "reward"  #: the function that is the prior

_LONGEST = 20_000  # characters of a file, without lines of comment: a record grows with its candidates
_DEEPEST = 60  # levels of the syntax tree
_MOST_TURNS = 100  # of one loop
_MODULES = ("numpy", "math")


@dataclass(frozen=True)
class Admitted:
    """Code within the subset."""

    code: CodeType
    reads: frozenset[str]  #: of `words.ACCESSORS`, what it looks at
    where: str  #: file, for messages

    def function(self) -> Callable[[Any], float]:
        """The prior, ready to be called with a `PriorStep`.

        Raises:
            RefusedCodeError: one of its constants cannot be computed; names the line.
        """
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
    """Check code, without running it.

    Args:
        source: of a whole file.
        where: the file, for messages.

    Raises:
        RefusedCodeError: names the line and the construct that the subset does not have.
    """
    try:
        with warnings.catch_warnings(action="ignore"):  # of the parser, about texts that are dropped
            text = _text(source, where)
            scope = Scope(where, text)
            made = _Statements(scope).module(_shallow(ast.parse(text), where))
            code = compile(made, where, "exec", dont_inherit=True)  # refuses loops within twenty others, too
    except SyntaxError as error:
        raise RefusedCodeError(f"{where}, line {error.lineno}: {error.msg}") from None
    except (RecursionError, MemoryError):  # of the parser, which cannot say where
        raise RefusedCodeError(f"{where}: nested too deeply") from None
    if ENTRY not in scope.work:
        raise RefusedCodeError(f"{where}: no function {ENTRY}(step)")
    return Admitted(code, frozenset(scope.reads), where)


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


def _shallow(tree: ast.Module, where: str) -> ast.Module:
    level: list[ast.AST] = [tree]
    for _ in range(_DEEPEST):
        level = [child for node in level for child in ast.iter_child_nodes(node) if child._fields]
    if level:
        raise RefusedCodeError(f"{where}, line {max(getattr(node, 'lineno', 1) for node in level)}: nested too deeply")
    return tree


class _Statements:
    """Translates a file; what has no method of its own here is refused."""

    def __init__(self, scope: Scope) -> None:
        self._scope = scope
        self._expressions = Expressions(scope)

    def module(self, tree: ast.Module) -> ast.Module:
        body: list[ast.stmt] = []
        for node in tree.body:
            match node:
                case ast.Import():
                    self._import(node)
                case ast.Assign(targets=[ast.Name()]):
                    body += self._block([node])
                case ast.FunctionDef():
                    body.append(self._function(node))
                case _ if not _is_text(node):
                    raise self._scope.refused(node, "outside functions stand imports, constants and functions")
        return ast.fix_missing_locations(ast.Module(body, []))

    def _import(self, node: ast.Import) -> None:
        for alias in node.names:
            if alias.name not in _MODULES:
                raise self._scope.refused(node, "only numpy and math can be imported")
            name = alias.asname or alias.name
            self._scope.bind(name, "module", node)
            self._scope.modules[name] = alias.name

    def _function(self, node: ast.FunctionDef) -> ast.FunctionDef:
        scope, given = self._scope, node.args
        if node.decorator_list:
            raise scope.refused(node.decorator_list[0], "functions have no decorators")
        if given.posonlyargs or given.kwonlyargs or given.vararg or given.kwarg:
            raise scope.refused(node, f"{node.name}: parameters are plain names", short=True)
        if node.name == ENTRY and (len(given.args) != 1 or given.defaults):
            raise scope.refused(node, f"{ENTRY} has one parameter, the step", short=True)
        for default in given.defaults:
            if not isinstance(default, ast.Constant):
                raise scope.refused(default, "defaults are numbers")
        defaults = [self._expressions.translate(default) for default in given.defaults]
        with scope.function(node):
            for arg in given.args:
                scope.bind(arg.arg, "variable", arg)
            # Annotations are left out: nothing evaluates them, and what they bind is not bound.
            parameters = [ast.copy_location(ast.arg(arg.arg), arg) for arg in given.args]
            body = self._block(node.body)
        arguments = ast.arguments([], parameters, None, [], [], None, defaults)
        return ast.copy_location(ast.FunctionDef(node.name, arguments, body, []), node)

    def _block(self, statements: list[ast.stmt]) -> list[ast.stmt]:
        """At least one statement; each costs work, so that a loop around nothing is not free."""
        kept = [node for node in statements if not _is_text(node)]
        made = []
        for node in kept or [ast.copy_location(ast.Pass(), statements[0])]:
            self._scope.spend(1, node)
            made.append(ast.copy_location(self._new(node), node))
        return made

    @singledispatchmethod
    def _new(self, node: ast.stmt) -> ast.stmt:
        raise self._scope.refused(node, "this kind of statement is not allowed")

    @_new.register(ast.Pass)
    @_new.register(ast.Break)
    @_new.register(ast.Continue)
    def _(self, node: ast.Pass | ast.Break | ast.Continue) -> ast.stmt:
        return type(node)()  # whether there is a loop around it, the compiler sees

    @_new.register
    def _(self, node: ast.Return) -> ast.stmt:
        if node.value is None:
            raise self._scope.refused(node, "a function returns a value")
        return ast.Return(self._expressions.translate(node.value))

    @_new.register(ast.Assign)
    @_new.register(ast.AnnAssign)
    def _(self, node: ast.Assign | ast.AnnAssign) -> ast.stmt:
        if node.value is None:
            raise self._scope.refused(node, "an annotation without a value")
        value = self._expressions.translate(node.value)
        targets = node.targets if isinstance(node, ast.Assign) else [node.target]
        return ast.Assign([self._target(target) for target in targets], value)

    @_new.register
    def _(self, node: ast.AugAssign) -> ast.stmt:
        # Not in place: an array that a constant holds must stay as it is.
        value = self._expressions.translate(ast.copy_location(ast.BinOp(node.target, node.op, node.value), node))
        return ast.Assign([self._target(node.target)], value)

    @_new.register
    def _(self, node: ast.If) -> ast.stmt:
        test = self._expressions.translate(node.test)
        return ast.If(test, self._block(node.body), self._block(node.orelse) if node.orelse else [])

    @_new.register
    def _(self, node: ast.For) -> ast.stmt:
        if node.orelse:
            raise self._scope.refused(node.orelse[0], "a loop has no else")
        items, kind = self._turns(node)
        target = self._target(node.target, kind)
        with self._scope.loop(len(items)):
            self._scope.spend(1, node)
            body = self._block(node.body)
        return ast.For(target, ast.Tuple(items, ast.Load()), body, [])

    def _turns(self, node: ast.For) -> tuple[list[ast.expr], ValueKind]:
        """What the loop's variable stands for in each turn, written out, and the kind of name that it is."""
        match node.iter:
            case ast.Tuple(elts=items) | ast.List(elts=items):
                return self._expressions.items(items, node.iter), "variable"
            case ast.Call(func=ast.Name(id="range"), args=[*bounds], keywords=[]) if len(bounds) in (1, 2):
                turns = range(*map(self._count, bounds))
                if len(turns) > _MOST_TURNS:
                    raise self._scope.refused(node.iter, f"a loop takes at most {_MOST_TURNS} turns")
                return [ast.Constant(turn) for turn in turns], "counter"
            case _:
                raise self._scope.refused(node.iter, "loops run over range(number) or over a tuple that is written out")

    def _count(self, node: ast.expr) -> int:
        if not isinstance(node, ast.Constant) or type(node.value) is not int or node.value > 1e6:
            raise self._scope.refused(node, "the bounds of range are numbers")
        return node.value

    def _target(self, node: ast.expr, kind: ValueKind = "variable") -> ast.expr:
        match node:
            case ast.Name():
                self._scope.spend(1, node)
                self._scope.bind(node.id, kind if self._scope.inside else "constant", node)
                return ast.copy_location(ast.Name(node.id, ast.Store()), node)
            case ast.Tuple() if all(isinstance(part, ast.Name) for part in node.elts):
                return ast.copy_location(ast.Tuple([self._target(part) for part in node.elts], ast.Store()), node)
            case _:
                raise self._scope.refused(node, "only names can be assigned to")


def _is_text(node: ast.stmt) -> bool:
    """A docstring, or a text that stands alone: nothing happens there."""
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
