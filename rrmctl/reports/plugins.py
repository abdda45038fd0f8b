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


def entries(folder: str, package: str) -> dict[str, Entry]:
    """The modules of a package in order of their names, by name; those with an underscore in front are not commands.

    Args:
        folder: of the package, or its `__file__`.
        package: its dotted name.
    """
    found = {}
    for path in sorted(Path(folder).parent.glob("[!_]*.py")):
        name = path.stem.replace("_", "-")
        module = ast.parse(path.read_bytes())
        found[name] = Entry(name, ast.get_docstring(module) or "", f"{package}.{path.stem}", _options(module))
    return found


def choose(shelf: Mapping[str, Entry], name: str, kind: str) -> Entry:
    """The entry of this name.

    Raises:
        UserError: there is none; with the nearest that there is.
    """
    check_known(name, shelf, f'there is no {kind} "{name}"', "there are")
    return shelf[name]


def _options(module: ast.Module) -> tuple[str, ...]:
    """The literal that a module gives the name OPTIONS."""
    for node in module.body:
        if isinstance(node, ast.Assign) and [ast.unparse(target) for target in node.targets] == ["OPTIONS"]:
            return tuple(ast.literal_eval(node.value))
    return ()
