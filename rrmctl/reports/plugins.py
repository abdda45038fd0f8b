"""Folders whose modules are commands: a table or a figure is added as one file, and the command line shows it.

A module's name is the command's, its docstring the command's help, `OPTIONS` names those of its own. All are read
without importing it, so that `--help` stays quick.
"""

from __future__ import annotations

import ast
import importlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

from rrmctl.errors import check_known


@dataclass(frozen=True)
class Entry:
    """One module of a shelf."""

    name: str  #: as people write it
    help: str
    path: str  #: dotted
    options: tuple[str, ...] = ()  #: that only some of the shelf have

    def load(self) -> ModuleType:
        """Import the module."""
        return importlib.import_module(self.path)


def entries(file: str, package: str) -> dict[str, Entry]:
    """The modules of a package beside its `__file__`, by name; those with an underscore in front are not commands."""
    shelf = {}
    for path in sorted(Path(file).parent.glob("[!_]*.py")):
        name, module = path.stem.replace("_", "-"), ast.parse(path.read_bytes())
        literals = {ast.unparse(node.targets[0]): node.value for node in module.body if isinstance(node, ast.Assign)}
        options = tuple(ast.literal_eval(literals["OPTIONS"])) if "OPTIONS" in literals else ()
        shelf[name] = Entry(name, ast.get_docstring(module) or "", f"{package}.{path.stem}", options)
    return shelf


def choose(shelf: Mapping[str, Entry], name: str, kind: str) -> Entry:
    """The entry of this name; where there is none, the error names the nearest that there is."""
    check_known(name, shelf, f'there is no {kind} "{name}"', "there are")
    return shelf[name]
