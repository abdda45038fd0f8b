"""Folders whose modules are commands: a table or a figure is added as one file, and the command line shows it.

A module's name is the command's, its docstring the command's help. Both are read without importing it, so that `--help`
stays quick.
"""

from __future__ import annotations

import ast
import importlib
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType


@dataclass(frozen=True)
class Entry:
    """One module of a shelf."""

    name: str  #: as people write it
    help: str
    path: str  #: dotted

    def load(self) -> ModuleType:
        """Import the module."""
        return importlib.import_module(self.path)


def entries(folder: str, package: str) -> dict[str, Entry]:
    """The modules of a package in order of their names, by name; those with an underscore in front are not commands.

    Args:
        folder: of the package, or its `__file__`.
        package: its dotted name.
    """
    found = {}
    for path in sorted(Path(folder).parent.glob("[!_]*.py")):
        name = path.stem.replace("_", "-")
        words = ast.get_docstring(ast.parse(path.read_bytes())) or ""
        found[name] = Entry(name, words, f"{package}.{path.stem}")
    return found
