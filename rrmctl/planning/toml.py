"""TOML files as people write them: read, and refused where no setting can be like that.

What passes can be shown in a message, written as JSON, and named to the file system: no integers beyond 64 bits, no
tables within tables without end, no control characters.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from rrm.files import read_bounded
from rrm.toml import DEEPEST, loads
from rrmctl.errors import UserError, shown

_LARGEST_FILE = 2**18  # bytes; the largest of the project's own has two thousand
_LONGEST_KEY = 100

#: Null bytes, escape sequences and halves of characters. Line breaks and tabs may stand in a text, not in a key.
_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\ud800-\udfff]")


def read_toml(path: Path) -> dict[str, Any]:
    """The file's content.

    Raises:
        UserError: it cannot be read, or is not TOML; the message names file, line and column.
    """
    try:
        table = loads(read_bounded(path, _LARGEST_FILE).decode("utf-8-sig"))
    except UnicodeDecodeError as error:
        raise UserError(f"{path}: not UTF-8 text: {error.reason} at byte {error.start}") from None
    except ValueError as error:
        raise UserError(f"{path}: {error}") from None
    except OSError as error:
        raise UserError(f"cannot read {path}: {error.strerror}") from None
    refuse_odd(table, str(path))
    return table


def refuse_odd(value: Any, where: str, name: str = "", depth: int = 0) -> None:
    """Refuse what TOML can say and no setting, name or path can be.

    Raises:
        UserError: with the place of the first such value.
    """
    place = f"{where}: {name}" if name else where
    if depth > DEEPEST:
        raise UserError(f"{place}: nested too deeply, in more than {DEEPEST} tables and lists")
    match value:
        case dict():
            for key, inner in value.items():
                if _CONTROL.search(key) or "\n" in key or len(key) > _LONGEST_KEY:
                    raise UserError(f"{place}: {shown(key)} cannot be a key", "at most 100 characters, in one line")
                refuse_odd(inner, where, f"{name}.{key}" if name else key, depth + 1)
        case list():
            for inner in value:
                refuse_odd(inner, where, name, depth + 1)
        case str() if _CONTROL.search(value):
            raise UserError(f"{place}: {shown(value)} holds a control character")
        case int() if not -(2**63) <= value < 2**63:
            raise UserError(f"{place}: an integer of more than 64 bits is too large")
