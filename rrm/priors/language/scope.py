"""What a translation knows of the code so far: its names and their kinds, what it looks at, and how much work it is."""

from __future__ import annotations

import ast
from collections import ChainMap
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Literal

from rrm.errors import RefusedCodeError
from rrm.priors.language.vocabulary import FUNCTIONS

MOST_WORK = 15_000  #: statements, expressions and bindings that one call takes, counted through loops and calls
_MOST_FUNCTIONS = 32  # each calls those above it, so that many calls are open at once

#: Only a `counter` is sure to be an integer; nothing else can be bound to its name.
ValueKind = Literal["word", "module", "constant", "function", "variable", "counter"]
_VALUES = ("constant", "variable", "counter")


class Scope:
    """Names are bound and work is counted here."""

    def __init__(self, where: str, text: str) -> None:
        """Args: where: the file, for messages. text: the code in it."""
        self.where = where
        self.reads: set[str] = set()  #: accessors of the step
        self.modules: dict[str, str] = {}  #: alias -> numpy or math
        self.work: dict[str, int] = {}  #: of one call, for each function so far
        self.inside = False  #: a function
        self._text = text
        self._names: ChainMap[str, ValueKind] = ChainMap(dict.fromkeys((*FUNCTIONS, "range"), "word"))
        self._spent, self._turns = 0, 1

    @contextmanager
    def function(self, node: ast.FunctionDef) -> Iterator[None]:
        """Around parameters and body of a function; afterwards what a call of it costs is known."""
        if len(self.work) == _MOST_FUNCTIONS:
            raise self.refused(node, f"{_MOST_FUNCTIONS} functions are the most", short=True)
        self.bind(node.name, "function", node)
        before, self._spent, self.inside = self._spent, 0, True
        self._names = self._names.new_child()
        yield
        self._names = self._names.parents
        self.work[node.name], self._spent, self.inside = self._spent, before, False

    @contextmanager
    def loop(self, turns: int) -> Iterator[None]:
        """Around the body of a loop."""
        before, self._turns = self._turns, self._turns * turns
        yield
        self._turns = before

    def spend(self, work: int, node: ast.AST) -> None:
        """Count work of one execution of the node."""
        self._spent += work * self._turns
        if self._spent > MOST_WORK:
            raise self.refused(node, f"one call would take more than {MOST_WORK:,} operations")

    def has_value(self, name: str) -> bool:
        """Whether the name is bound above, to something that can be read."""
        return self._names.get(name) in _VALUES

    def counts(self, name: str) -> bool:
        """Whether the name stands for the turns of a range loop, and so for an integer."""
        return self._names.get(name) == "counter"

    def bind(self, name: str, kind: ValueKind, node: ast.AST) -> None:
        """Give a name to something: once in a file; in a function again to the same kind, also to hide a constant."""
        if name.startswith("__"):
            raise self.refused(node, f"{name} begins with two underscores", short=True)
        known = self._names.get(name)
        if known is not None and not (self.inside and known in (kind, "constant")):
            raise self.refused(node, f"{name} is a {known} already; give this another name", short=True)
        self._names[name] = kind

    def refused(self, node: ast.AST, why: str, *, short: bool = False) -> RefusedCodeError:
        """The error for code that goes too far.

        Args:
            node: the construct, shown with its line.
            short: leave the construct out, where it is as long as a whole function.
        """
        text = "" if short else " ".join((ast.get_source_segment(self._text, node) or "").split())
        shown = f"`{text if len(text) <= 60 else text[:57] + '...'}` ({type(node).__name__}): " if text else ""
        return RefusedCodeError(f"{self.where}, line {getattr(node, 'lineno', '?')}: {shown}{why}")
