"""Code that a language model wrote becomes code that can be run: a syntax tree built anew from a small subset.

What is not translated does not exist: every node of the result is made here, every name in it is the code's own or one
of `words`, and arithmetic goes through functions that keep numbers and arrays small. Loops run over what is written
out, functions call only those above them, and the work of one call is counted beforehand, so the code always ends.
"""

from __future__ import annotations

import ast
import unicodedata
from collections.abc import Callable
from dataclasses import dataclass
from functools import singledispatchmethod
from typing import Any

from rrm.errors import RefusedCodeError
from rrm.priors.language.expressions import Expressions
from rrm.priors.language.scope import Scope

ENTRY = "reward"  #: the function that is the prior

_LONGEST = 20_000  # characters of a file
_DEEPEST = 60  # levels of the syntax tree
_MOST_TURNS = 100  # of one loop
_MODULES = ("numpy", "math")


@dataclass(frozen=True)
class Admitted:
    """Code within the subset."""

    tree: ast.Module
    reads: frozenset[str]  #: of `words.ACCESSORS`, what it looks at
    where: str  #: file, for messages

    def function(self) -> Callable[[Any], float]:
        """The prior, ready to be called with a `PriorStep`.

        Raises:
            RefusedCodeError: one of its constants cannot be computed.
        """
        from rrm.priors.language.guards import namespace  # numpy, which planning does without

        room = namespace()
        try:
            exec(compile(self.tree, self.where, "exec", dont_inherit=True), room)  # noqa: S102  (it is what we made)
        except Exception as error:
            raise RefusedCodeError(f"{self.where}: {type(error).__name__} in a constant: {error}") from error
        entry: Callable[[Any], float] = room[ENTRY]
        return entry


def admit(source: bytes, where: str) -> Admitted:
    """Check code, without running it.

    Args:
        source: of a whole file.
        where: the file, for messages.

    Raises:
        RefusedCodeError: names the line and the construct that the subset does not have.
    """
    scope = Scope(where)
    tree = _Statements(scope).module(_parse(source, where))
    if ENTRY not in scope.work:
        raise RefusedCodeError(f"{where}: no function {ENTRY}(step)")
    return Admitted(tree, frozenset(scope.reads), where)


def _parse(source: bytes, where: str) -> ast.Module:
    try:
        text = source.decode()
    except UnicodeDecodeError:
        raise RefusedCodeError(f"{where}: not UTF-8 text") from None
    if len(text) > _LONGEST:
        raise RefusedCodeError(f"{where}: {len(text):,} characters; {_LONGEST:,} are the most")
    for number, line in enumerate(text.split("\n"), start=1):
        if any(unicodedata.category(sign).startswith("C") and sign not in "\t\r" for sign in line):
            raise RefusedCodeError(f"{where}, line {number}: an invisible character")
    try:
        tree = ast.parse(text)
    except SyntaxError as error:
        raise RefusedCodeError(f"{where}, line {error.lineno}: {error.msg}") from None
    except (ValueError, RecursionError, MemoryError) as error:
        raise RefusedCodeError(f"{where}: {type(error).__name__} while it was read: {error}") from None
    level: list[ast.AST] = [tree]
    for _ in range(_DEEPEST):
        level = [child for node in level for child in ast.iter_child_nodes(node)]
    if level:
        raise RefusedCodeError(f"{where}, line {getattr(level[0], 'lineno', '?')}: nested too deeply")
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
                case ast.Assign(targets=[ast.Name(id=name)]):
                    body += self._block([node])
                    self._scope.constants.add(self._scope.new(name, node))
                case ast.FunctionDef():
                    body.append(self._function(node))
                case _ if not _is_text(node):
                    raise self._scope.refused(node, "outside functions stand imports, constants and functions")
        return ast.fix_missing_locations(ast.Module(body, []))

    def _import(self, node: ast.Import) -> None:
        for alias in node.names:
            if alias.name not in _MODULES:
                raise self._scope.refused(node, "only numpy and math can be imported")
            self._scope.modules[self._scope.new(alias.asname or alias.name, node)] = alias.name

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
        # Annotations are left out: nothing evaluates them.
        parameters = [ast.copy_location(ast.arg(scope.bind(arg.arg, arg)), arg) for arg in given.args]
        scope.new(node.name, node)
        with scope.function(node.name, {arg.arg for arg in parameters} | _assigned(node)):
            body = self._block(node.body)
        arguments = ast.arguments([], parameters, None, [], [], None, defaults)
        return ast.copy_location(ast.FunctionDef(node.name, arguments, body, []), node)

    def _block(self, statements: list[ast.stmt]) -> list[ast.stmt]:
        kept = [node for node in statements if not _is_text(node)]
        return [ast.copy_location(self._new(node), node) for node in kept] or [ast.Pass()]

    @singledispatchmethod
    def _new(self, node: ast.stmt) -> ast.stmt:
        raise self._scope.refused(node, "this kind of statement is not allowed")

    @_new.register
    def _(self, node: ast.Pass) -> ast.stmt:  # noqa: ARG002
        return ast.Pass()

    @_new.register
    def _(self, node: ast.Return) -> ast.stmt:
        if node.value is None:
            raise self._scope.refused(node, "a function returns a value")
        return ast.Return(self._expressions.translate(node.value))

    @_new.register
    def _(self, node: ast.Assign) -> ast.stmt:
        return ast.Assign([self._target(target) for target in node.targets], self._expressions.translate(node.value))

    @_new.register
    def _(self, node: ast.AnnAssign) -> ast.stmt:
        if node.value is None:
            raise self._scope.refused(node, "an annotation without a value")
        return ast.Assign([self._target(node.target)], self._expressions.translate(node.value))

    @_new.register
    def _(self, node: ast.AugAssign) -> ast.stmt:
        target = self._target(node.target)
        assert isinstance(node.target, ast.Name)  # Python's grammar leaves attributes and subscripts, refused above
        # Not in place: an array that a constant holds must stay as it is.
        old = self._expressions.translate(ast.copy_location(ast.Name(node.target.id, ast.Load()), node))
        return ast.Assign([target], self._expressions.operation(node, old, self._expressions.translate(node.value)))

    @_new.register
    def _(self, node: ast.If) -> ast.stmt:
        test = self._expressions.translate(node.test)
        return ast.If(test, self._block(node.body), self._block(node.orelse) if node.orelse else [])

    @_new.register
    def _(self, node: ast.For) -> ast.stmt:
        if node.orelse:
            raise self._scope.refused(node.orelse[0], "a loop has no else")
        items = self._turns(node)
        with self._scope.loop(len(items)):
            body = self._block(node.body)
        return ast.For(self._target(node.target), ast.Tuple(items, ast.Load()), body, [])

    @_new.register(ast.Break)
    @_new.register(ast.Continue)
    def _(self, node: ast.Break | ast.Continue) -> ast.stmt:
        if not self._scope.loops:
            raise self._scope.refused(node, "there is no loop around it")
        return type(node)()

    def _turns(self, node: ast.For) -> list[ast.expr]:
        """What the loop's variable stands for in each turn, written out."""
        match node.iter:
            case ast.Tuple(elts=items) | ast.List(elts=items):
                return self._expressions.items(items, node.iter)
            case ast.Call(func=ast.Name(id="range"), args=[*bounds], keywords=[]) if len(bounds) in (1, 2):
                turns = range(*map(self._count, bounds))
                if len(turns) > _MOST_TURNS:
                    raise self._scope.refused(node.iter, f"a loop takes at most {_MOST_TURNS} turns")
                if isinstance(node.target, ast.Name):
                    self._scope.counters.add(node.target.id)
                return [ast.Constant(turn) for turn in turns]
            case _:
                raise self._scope.refused(node.iter, "loops run over range(number) or over a tuple that is written out")

    def _count(self, node: ast.expr) -> int:
        if not isinstance(node, ast.Constant) or type(node.value) is not int or node.value > 1e6:
            raise self._scope.refused(node, "the bounds of range are numbers")
        return node.value

    def _target(self, node: ast.expr) -> ast.expr:
        match node:
            case ast.Name():
                return ast.copy_location(ast.Name(self._scope.bind(node.id, node), ast.Store()), node)
            case ast.Tuple() if all(isinstance(part, ast.Name) for part in node.elts):
                return ast.copy_location(ast.Tuple([self._target(part) for part in node.elts], ast.Store()), node)
            case _:
                raise self._scope.refused(node, "only names can be assigned to")


def _is_text(node: ast.stmt) -> bool:
    """A docstring, or a text that stands alone: nothing happens there."""
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


def _assigned(function: ast.FunctionDef) -> set[str]:
    """Names that the function stores to anywhere; whether they may be stored to is seen when that line is reached."""
    return {node.id for node in ast.walk(function) if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)}
