"""JSON files of the store: written with a checksum, and read as records whose fields are there and of the right kind.

Records are dataclasses with Pydantic's types as annotations: strict ones, since JSON's true is no number.
"""

from __future__ import annotations

import dataclasses
import json
import math
import zlib
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

from pydantic import Field, Strict, TypeAdapter, ValidationError

from rrmctl.store.files import DamagedError, VersionError, read_bytes, write_bytes
from rrmctl.store.layout import RUN_ID
from rrmctl.store.schema import SCHEMA_VERSION

if TYPE_CHECKING:
    from _typeshed import DataclassInstance
    from pydantic_core import ErrorDetails

    Record = TypeVar("Record", bound=DataclassInstance)

#: A run's identity.
RunId = Annotated[str, Strict(), Field(pattern=f"^{RUN_ID.pattern}$")]

#: The end of a file of at least one entry. One without it was written by hand, or by an earlier version.
_CHECKSUM = b',\n "checksum": "%08x"\n}\n'
_LENGTH = len(_CHECKSUM % 0)

_LARGEST = 2**28  # bytes; the record of a hundred thousand runs has an eighth of it
_DEEPEST = 50

_AGAIN = "move it away; what it recorded is made again"

_KINDS = {
    "string_type": "text", "int_type": "a whole number", "float_type": "a number", "bool_type": "true or false",
    "dataclass_type": "an object", "dict_type": "an object", "list_type": "a list", "tuple_type": "a list",
    "string_pattern_mismatch": "16 hexadecimal digits",
}  # fmt: skip


def write_json(path: Path, value: Mapping[str, Any]) -> None:
    """`write_bytes` of `value` as indented JSON, its last line a checksum over those before. NaN is a ValueError."""
    body = json.dumps(value, indent=1, allow_nan=False).removesuffix("\n}").encode()
    write_bytes(path, body + (_CHECKSUM % zlib.crc32(body) if value else b"\n"))


def read_json(path: Path, hint: str = _AGAIN) -> dict[str, Any] | None:
    """The object in `path`; None where there is no such file. `hint`: what to do about one that is damaged."""
    data = read_bytes(path, _LARGEST)
    if data is None:
        return None
    try:
        value = json.loads(data.decode())
        _refuse_odd(value)
    except (ValueError, RecursionError) as error:
        raise DamagedError(f"{path} cannot be read: {error}", hint) from error
    if not isinstance(value, dict):
        raise DamagedError(f"{path} does not hold a JSON object", hint)
    body, end = data[:-_LENGTH], data[-_LENGTH:]
    if value.pop("checksum", None) and end.startswith(_CHECKSUM[:14]) and end != _CHECKSUM % zlib.crc32(body):
        raise DamagedError(f"{path} is damaged: its content does not match its checksum", hint)
    return value


def _refuse_odd(value: Any) -> None:
    """Refuse what JSON can say, no file of the store does, and readers would stumble over. Raises ValueError."""
    left = [(value, 0)]
    while left:
        value, depth = left.pop()
        if depth > _DEEPEST:
            raise ValueError(f"nested more than {_DEEPEST} times")
        match value:
            case dict():
                left += [(part, depth + 1) for entry in value.items() for part in entry]
            case list():
                left += [(part, depth + 1) for part in value]
            case str():
                value.encode()  # halves of characters
            case int() if not -(2**63) <= value < 2**63:
                raise ValueError("an integer of more than 64 bits")
            case float() if not math.isfinite(value):
                raise ValueError(f"{value} is no number")


def check_version(version: Any, path: Path, hint: str) -> None:
    """Refuse another schema version than this program's (VersionError), and what is none (DamagedError)."""
    if type(version) is not int:
        raise DamagedError(f"{path} is damaged: its schema_version is {version!r:.80}, not a whole number", hint)
    if version != SCHEMA_VERSION:
        raise VersionError(
            f"{path} is of schema version {version}, this program reads {SCHEMA_VERSION}",
            "nothing was touched; use the rrmctl that wrote it, or another --results folder",
        )


def read_record(kind: type[Record], path: Path, hint: str, optional: str = "") -> Record | None:
    """The record in this file, as `validated` has it; None where there is none."""
    content = read_json(path, hint)
    if content is None:
        return None
    check_version(content.pop("schema_version", None), path, hint)
    return validated(kind, content, path, hint, optional)


def validated(kind: type[Record], content: Mapping[str, Any], path: Path, hint: str, optional: str = "") -> Record:
    """What was read from `path` as a record.

    Args:
        optional: fields that a file may lack, in one text; of inner records those that have a default may be missing.
    """
    needed = {field.name for field in dataclasses.fields(kind)} - {*optional.split()}
    if lacking := [name for name in needed if name not in content]:
        raise DamagedError(f"{path} is damaged: it lacks {', '.join(sorted(lacking))}", hint)
    try:
        record: Record = _adapter(kind).validate_python(content)
    except ValidationError as error:
        raise DamagedError(f"{path} is damaged: {_told(error.errors())}", hint) from error
    return record


_adapter = cache(TypeAdapter[Any])


def _told(problems: list[ErrorDetails]) -> str:
    """The first thing that is wrong, with everything that is missing at its place."""
    first = problems[0]
    if first["type"] == "missing":
        return f"it lacks {', '.join(_place(problem) for problem in problems if problem['type'] == 'missing')}"
    wrong = f"{_place(first)} is {first['input']!r:.80}"
    wanted = _KINDS.get(first["type"])
    return f"{wrong}, not {wanted}" if wanted else f"{wrong}: {first['msg']}"


def _place(problem: ErrorDetails) -> str:
    """`jobs[0].seed`."""
    return "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in problem["loc"]).removeprefix(".")


def settings(config: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """The values of a configuration by dotted name; a list is one value."""
    values: dict[str, Any] = {}
    for name, value in config.items():
        inner = isinstance(value, Mapping)
        values |= settings(value, f"{prefix}{name}.") if inner else {prefix + name: value}
    return values
