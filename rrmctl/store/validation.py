"""Whether the fields of a JSON object are there and of the right kind. A plain loop: thousands are read at a time."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rrmctl.store.files import DamagedError, VersionError
from rrmctl.store.layout import RUN_ID
from rrmctl.store.schema import SCHEMA_VERSION

#: Kinds of values. By exact type: JSON's true is no number.
Kind = tuple[type, ...]
TEXT: Kind = (str,)
WHOLE: Kind = (int,)
NUMBER: Kind = (int, float)
FLAG: Kind = (bool,)
OBJECT: Kind = (dict,)
LIST: Kind = (list,)
NONE: Kind = (type(None),)

_WORDS: dict[type, str] = {
    str: "text", int: "a whole number", float: "a number", bool: "true or false", dict: "an object", list: "a list",
    type(None): "null",
}  # fmt: skip


def check(value: Mapping[str, Any], kinds: Mapping[str, Kind], path: Path, hint: str, where: str = "") -> None:
    """Refuse an object that lacks one of these fields, or holds something else in it. Further fields are not looked at.

    Args:
        value: as read from `path`.
        where: what stands before a field's name in messages, such as `jobs[0].`.

    Raises:
        DamagedError: naming file and field.
    """
    missing = [name for name in kinds if name not in value]
    if missing:
        raise DamagedError(f"{path} is damaged: it lacks {', '.join(where + name for name in missing)}", hint)
    for name, kind in kinds.items():
        if type(value[name]) not in kind:
            wanted = " or ".join(_WORDS[each] for each in kind if not (each is int and float in kind))
            raise DamagedError(f"{path} is damaged: {where}{name} is {value[name]!r:.80}, not {wanted}", hint)


def check_version(content: dict[str, Any], path: Path, hint: str) -> None:
    """Take the schema version out of what was read from `path`, and refuse another than this program's.

    Raises:
        VersionError: it is another one.
        DamagedError: there is none.
    """
    check(content, {"schema_version": WHOLE}, path, hint)
    version = content.pop("schema_version")
    if version != SCHEMA_VERSION:
        raise VersionError(
            f"{path} is of schema version {version}, this program reads {SCHEMA_VERSION}",
            "nothing was touched; use the rrmctl that wrote it, or another --results folder",
        )


def check_run_id(value: str, path: Path, hint: str, where: str) -> None:
    """Refuse what is not a run's identity.

    Raises:
        DamagedError: naming file and field.
    """
    if not RUN_ID.fullmatch(value):
        raise DamagedError(f"{path} is damaged: {where} is {value!r:.80}, not 16 hexadecimal digits", hint)
