"""Expressions of a language prior, built anew: arithmetic through guards, and no names but those of the vocabulary.

Each of them costs work, and whatever one gives passes one check of what it is and how large.
"""

from __future__ import annotations

import ast
from collections.abc import Iterable
from functools import singledispatchmethod

from rrm.priors.language.scope import Scope
from rrm.priors.language.vocabulary import ACCESSORS, CONSTANTS, FUNCTIONS, OPERATORS, VALUE

_MOST_ITEMS = 32  # of a tuple, list or call
_LARGEST = 1e9  # number written out
_COMPARISONS = (ast.Lt, ast.LtE, ast.Gt, ast.GtE, ast.Eq, ast.NotEq)
_SIGNS = (ast.USub, ast.UAdd, ast.Not)


class Expressions:
    """Translates one expression after another; what has no method of its own here is refused."""

    def __init__(self, scope: Scope) -> None:
        self._scope = scope

    def translate(self, node: ast.expr) -> ast.expr:
        """The expression, rebuilt and counted.

        Raises:
            RefusedCodeError: the subset does not have it.
        """
        self._scope.spend(1, node)
        new = ast.copy_location(self._new(node), node)
        if isinstance(new, ast.Constant | ast.Name):  # numbers that are written out, and what has been checked already
            return new
        return ast.copy_location(_called(VALUE, [new]), node)

    def items(self, nodes: list[ast.expr], whole: ast.expr) -> list[ast.expr]:
        """The parts of a tuple, list or call that is written out."""
        if len(nodes) > _MOST_ITEMS:
            raise self._scope.refused(whole, f"{len(nodes)} items; {_MOST_ITEMS} are the most")
        return [self.translate(node) for node in nodes]

    @singledispatchmethod
    def _new(self, node: ast.expr) -> ast.expr:
        raise self._scope.refused(node, "this kind of expression is not allowed")

    @_new.register
    def _(self, node: ast.Constant) -> ast.expr:
        if not isinstance(node.value, bool | int | float):
            raise self._scope.refused(node, "values that can be written are numbers, True and False")
        if not abs(node.value) <= _LARGEST:
            raise self._scope.refused(node, f"numbers are {_LARGEST:,.0f} at the most")
        return ast.Constant(float(node.value))

    @_new.register
    def _(self, node: ast.Name) -> ast.expr:
        if not self._scope.has_value(node.id):
            raise self._scope.refused(node, "not a parameter, variable or constant of this code, up to here")
        return ast.Name(node.id, ast.Load())

    @_new.register
    def _(self, node: ast.Attribute) -> ast.expr:
        path = self._path(node)
        if path is not None:
            if path not in CONSTANTS:
                raise self._scope.refused(node, "not a constant of numpy or math that can be used here")
            return ast.Name(path, ast.Load())
        if node.attr not in ACCESSORS:
            raise self._scope.refused(node, f"what can be read, of the step, is {', '.join(sorted(ACCESSORS))}")
        self._scope.reads.add(node.attr)
        return ast.Attribute(self.translate(node.value), node.attr, ast.Load())

    @_new.register
    def _(self, node: ast.BinOp) -> ast.expr:
        name = type(node.op).__name__
        if name not in OPERATORS:
            raise self._scope.refused(node, "operators are + - * / // % **")
        return _called(f"operator {name}", [self.translate(node.left), self.translate(node.right)])

    @_new.register
    def _(self, node: ast.UnaryOp) -> ast.expr:
        if not isinstance(node.op, _SIGNS):
            raise self._scope.refused(node, "signs are + - not")
        return ast.UnaryOp(node.op, self.translate(node.operand))

    @_new.register
    def _(self, node: ast.BoolOp) -> ast.expr:
        return ast.BoolOp(node.op, self.items(node.values, node))

    @_new.register
    def _(self, node: ast.Compare) -> ast.expr:
        if not all(isinstance(op, _COMPARISONS) for op in node.ops):
            raise self._scope.refused(node, "comparisons are < <= > >= == !=")
        return ast.Compare(self.translate(node.left), node.ops, self.items(node.comparators, node))

    @_new.register
    def _(self, node: ast.IfExp) -> ast.expr:
        return ast.IfExp(self.translate(node.test), self.translate(node.body), self.translate(node.orelse))

    @_new.register
    def _(self, node: ast.Subscript) -> ast.expr:
        return ast.Subscript(self.translate(node.value), self._index(node.slice), ast.Load())

    @_new.register(ast.Tuple)
    @_new.register(ast.List)
    def _(self, node: ast.Tuple | ast.List) -> ast.expr:
        return ast.Tuple(self.items(node.elts, node), ast.Load())

    @_new.register
    def _(self, node: ast.Call) -> ast.expr:
        scope = self._scope
        name = (node.func.id if isinstance(node.func, ast.Name) else self._path(node.func)) or ""
        words = {word.arg: word.value for word in node.keywords if word.arg is not None}
        if name in scope.work and scope.inside:
            scope.spend(scope.work[name], node)
        elif name not in FUNCTIONS:
            raise scope.refused(node.func, "not a function that can be called here; of the code's own, those above can")
        elif len(node.args) > FUNCTIONS[name].most or not words.keys() <= FUNCTIONS[name].keywords:
            raise scope.refused(node, f"{name} takes at most {FUNCTIONS[name].most} plain arguments here")
        if len(words) < len(node.keywords):
            raise scope.refused(node, "arguments are written out")
        keywords = [ast.keyword(word, value) for word, value in zip(words, self._each(words.values()), strict=True)]
        return ast.Call(ast.Name(name, ast.Load()), self.items(node.args, node), keywords)

    def _each(self, nodes: Iterable[ast.expr]) -> list[ast.expr]:
        return [self.translate(node) for node in nodes]

    def _path(self, node: ast.expr) -> str | None:
        """`numpy.linalg.norm` for what `np.linalg.norm` says; None for what has no module at its root."""
        if isinstance(node, ast.Name):
            return self._scope.modules.get(node.id)
        root = self._path(node.value) if isinstance(node, ast.Attribute) else None
        return f"{root}.{node.attr}" if root is not None and isinstance(node, ast.Attribute) else None

    def _index(self, node: ast.expr) -> ast.expr:
        """A number, a loop's counter, or a slice between numbers: integers that stay integers."""
        match node:
            case ast.Slice(step=None):
                ends = (None if end is None else self._index(end) for end in (node.lower, node.upper))
                return ast.Slice(*ends)
            case ast.Constant() if type(node.value) is int and node.value < _LARGEST:
                return ast.Constant(node.value)
            case ast.UnaryOp(op=ast.USub(), operand=ast.Constant()):
                return ast.UnaryOp(ast.USub(), self._index(node.operand))
            case ast.Name() if self._scope.counts(node.id):
                return ast.Name(node.id, ast.Load())
            case _:
                raise self._scope.refused(
                    node, "an index is a number, a slice of numbers or the counter of a range loop"
                )


def _called(name: str, given: list[ast.expr]) -> ast.Call:
    return ast.Call(ast.Name(name, ast.Load()), given, [])
