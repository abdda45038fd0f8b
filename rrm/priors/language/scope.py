"""What a translation knows of the code so far: its names, what it looks at, and how much work it is."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from contextlib import contextmanager

from rrm.errors import RefusedCodeError
from rrm.priors.language.words import FUNCTIONS

_MOST_WORK = 5000  # nodes that one call of a function evaluates
_TAKEN = {*FUNCTIONS, "row", "range"}


class Scope:
    """Names are bound and work is counted here."""

    def __init__(self, where: str) -> None:
        """Args: where: the file, for messages."""
        self.where = where
        self.reads: set[str] = set()  #: accessors of the step
        self.modules: dict[str, str] = {}  #: alias -> numpy or math
        self.constants: set[str] = set()
        self.work: dict[str, int] = {}  #: of one call, for each function so far
        self.counters: set[str] = set()  #: variables of the function at hand that count the turns of a loop
        self.loops = 0  #: around the statement at hand
        self._variables: set[str] | None = None  # of the function at hand; None outside functions
        self._spent, self._turns = 0, 1

    @property
    def inside(self) -> bool:
        """Whether a function is being translated."""
        return self._variables is not None

    @contextmanager
    def function(self, name: str, variables: set[str]) -> Iterator[None]:
        """Around the body of a function; afterwards what a call of it costs is known."""
        self._variables, self.counters, self._spent = variables, set(), 0
        yield
        self._variables = None
        self.work[name] = self._spent

    @contextmanager
    def loop(self, turns: int) -> Iterator[None]:
        """Around the body of a loop."""
        before, self._turns, self.loops = self._turns, self._turns * turns, self.loops + 1
        yield
        self._turns, self.loops = before, self.loops - 1

    def spend(self, work: int, node: ast.AST) -> None:
        """Count work of one execution of the node."""
        self._spent += work * self._turns
        if self._spent > _MOST_WORK:
            raise self.refused(node, f"one call would take more than {_MOST_WORK} operations")

    def knows(self, name: str) -> bool:
        """Whether the name can be read as a value."""
        return name in self.constants or (self._variables is not None and name in self._variables)

    def new(self, name: str, node: ast.AST) -> str:
        """A name of the file, which is defined once."""
        if name in self.constants:
            raise self.refused(node, f"{name} is defined twice", short=True)
        return self.bind(name, node)

    def bind(self, name: str, node: ast.AST) -> str:
        """A name that code may give to something."""
        if name.startswith("__"):
            raise self.refused(node, f"{name} begins with two underscores", short=True)
        if name in _TAKEN or name in self.modules or name in self.work:
            raise self.refused(node, f"{name} means something else already", short=True)
        return name

    def refused(self, node: ast.AST, why: str, *, short: bool = False) -> RefusedCodeError:
        """The error for code that goes too far.

        Args:
            node: the construct, shown with its line.
            short: leave the construct out, where it is as long as a whole function.
        """
        text = "" if short else " ".join(ast.unparse(node).split())
        shown = f"`{text if len(text) <= 60 else text[:57] + '...'}` ({type(node).__name__}): " if text else ""
        return RefusedCodeError(f"{self.where}, line {getattr(node, 'lineno', '?')}: {shown}{why}")
