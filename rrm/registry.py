"""Tables of names: a name maps to a dotted path, so nothing heavy is imported before it is asked for."""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rrm.errors import ConfigError, UnknownNameError


def is_file_reference(name: str) -> bool:
    """True for `path/to/file.py:attribute`, the form in which users name code of their own."""
    path, _, attribute = name.rpartition(":")
    return path.endswith(".py") and attribute.isidentifier()


def lookup(table: Mapping[str, str], kind: str, name: str) -> Any:
    """The object that `name` stands for in `table`, or in a file of the user's when it reads `file.py:attribute`.

    Raises:
        UnknownNameError: no such name; the message lists what is known and the nearest match.
        ConfigError: the user's file is missing, does not import, or lacks the attribute.
    """
    if is_file_reference(name):
        return _from_file(name, kind)
    if name not in table:
        raise UnknownNameError(kind, name, table)
    module, _, attribute = table[name].partition(":")
    return getattr(importlib.import_module(module), attribute)


def source_digest(name: str) -> str | None:
    """Sha-256 of the user's file behind `file.py:attribute`; None for a name of ours.

    What that file imports from elsewhere is not part of it: a prior or learner is one self-contained file.

    Raises:
        ConfigError: the file cannot be read.
    """
    if not is_file_reference(name):
        return None
    path = Path(name.rpartition(":")[0])
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise ConfigError(f"cannot read {path} (named by {name!r}): {error.strerror}") from error


def _from_file(name: str, kind: str) -> Any:
    location, _, attribute = name.rpartition(":")
    path = Path(location)
    if not path.is_file():
        raise ConfigError(f"{kind} {name!r}: there is no file {path}; paths are relative to where the command runs")
    unique = hashlib.sha256(str(path.resolve()).encode()).hexdigest()[:8]
    spec = importlib.util.spec_from_file_location(f"rrm_user_{path.stem}_{unique}", path)
    assert spec is not None  # a .py path always has a loader
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:
        del sys.modules[spec.name]
        raise ConfigError(f"{kind} {name!r}: {path} does not import: {type(error).__name__}: {error}") from error
    try:
        return getattr(module, attribute)
    except AttributeError:
        raise ConfigError(f"{kind} {name!r}: {path} defines no {attribute!r}") from None
