"""Tables of names: a name maps to a dotted path, so nothing heavy is imported before it is asked for."""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import symtable
import sys
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rrm.errors import ConfigError, UnknownNameError, nearest
from rrm.files import place, read_bounded

#: How files end that hold a language model's code: `rrm.priors.language` rebuilds it, and it never runs as it stands.
LANGUAGE = ".language.py"
_MOST_CODE = 10_000_000  # bytes of a user's file


def is_file_reference(name: str) -> bool:
    """True for `path/to/file.py:attribute`, the form in which users name code of their own."""
    path, _, attribute = name.rpartition(":")
    return path.endswith(".py") and attribute.isidentifier()


def lookup(table: Mapping[str, str], kind: str, name: str) -> Any:
    """The object that `name` stands for in `table`, or in a file of the user's when it reads `file.py:attribute`."""
    if is_file_reference(name):
        return _from_file(name, kind)
    if name not in table:
        raise UnknownNameError(kind, name, table)
    module, _, attribute = table[name].partition(":")
    return getattr(importlib.import_module(module), attribute)


def check_file(name: str, kind: str) -> None:
    """Refuse a file of the user's that cannot hold what `file.py:attribute` names. The file is read, never run.

    What only running it shows (an import that fails, say) is refused by `lookup`, in the process that needs it.
    """
    path, attribute = _located(name, kind)
    try:
        with warnings.catch_warnings(action="ignore"):  # the run itself shows them, in its log
            source = read_bounded(path, _MOST_CODE)
            code = compile(source, str(path), "exec", dont_inherit=True)
            table = symtable.symtable(source, str(path), "exec")  # type: ignore[arg-type]  # bytes say their coding
    except SyntaxError as error:
        raise ConfigError(f"{kind} {name!r}: {path}, line {error.lineno}: {error.msg}") from None
    except (ValueError, RecursionError, MemoryError) as error:  # null bytes, nesting without end
        raise ConfigError(f"{kind} {name!r}: {path} is not Python: {error}") from None
    except OSError as error:
        raise ConfigError(f"cannot read {path} (named by {name!r}): {error.strerror}") from error
    names = {symbol.get_name() for symbol in table.get_symbols() if symbol.is_assigned() or symbol.is_imported()}
    if attribute not in names and "__getattr__" not in names and ("*",) not in code.co_consts:
        raise ConfigError(f"{kind} {name!r}: {path} defines no {attribute!r}{nearest(attribute, names)}")


def source_digest(name: str) -> str | None:
    """`file_digest` of the user's file behind `file.py:attribute`; None for a name of ours.

    What that file imports from elsewhere is not part of it: a prior or learner is one self-contained file.
    """
    return file_digest(Path(name.rpartition(":")[0]), name) if is_file_reference(name) else None


def file_digest(path: Path, name: str) -> str:
    """Sha-256 of a file of the user's; `name` is what they called it by."""
    path = place(path)
    try:
        if path.exists() and not path.is_file():  # a device may have no end
            raise ConfigError(f"cannot read {path} (named by {name!r}): not a file")
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise ConfigError(f"cannot read {path} (named by {name!r}): {error.strerror}") from error


def _located(name: str, kind: str) -> tuple[Path, str]:
    """File and attribute of `file.py:attribute`."""
    location, _, attribute = name.rpartition(":")
    path = place(location)
    try:
        there = path.is_file()
    except OSError as error:
        raise ConfigError(f"{kind} {name!r}: {path.absolute()}: {error.strerror}") from None
    if not there:
        raise ConfigError(f"{kind} {name!r}: there is no file {path.absolute()}")
    if any(file.name.lower().endswith(LANGUAGE) for file in (path, path.resolve())):
        raise ConfigError(f"{kind} {name!r}: *{LANGUAGE} holds a language model's code, which is never run as a {kind}")
    return path, attribute


def _from_file(name: str, kind: str) -> Any:
    path, attribute = _located(name, kind)
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
