"""Frozen language priors: files `NAME.language.py` that hold a function and where it came from.

The record is a block of comments at the top, TOML behind `# `, so that code and provenance are one file, with one
digest. Code in such a file is never run as a module: `rrm.priors.language.load` admits it or refuses it.
"""

from __future__ import annotations

import hashlib
import json
import tomllib
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from rrm.errors import ConfigError

SUFFIX = ".language.py"
_BEGIN, _END = "# /// language-prior", "# ///"


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """One function that a model wrote, and what became of it."""

    file: str  #: its name
    sha256: str  #: of the file as given
    score: float | None = None  #: agreement with the other candidates; None where it was refused or stands alone
    refused: str | None = None  #: why, where it was


@dataclass(frozen=True, kw_only=True)
class Record:
    """Where a frozen prior comes from."""

    task: str  #: the one it was written for
    model: str  #: which wrote it, as told by the user
    date: str  #: when, as told by the user
    prompt_sha256: str  #: of the prompt's text
    kept: str  #: file name of the candidate that was kept
    candidates: tuple[Candidate, ...]
    note: str | None = None


def sha256(data: bytes) -> str:
    """Hexadecimal digest."""
    return hashlib.sha256(data).hexdigest()


def freeze(record: Record, code: bytes) -> bytes:
    """A file's content: the record, then the candidate's code as it was given."""
    described = asdict(record)
    candidates = described.pop("candidates")
    lines = [_BEGIN, *_toml(described)]
    for candidate in candidates:
        lines += ["#", "# [[candidates]]", *_toml(candidate)]
    return "\n".join([*lines, _END, "", ""]).encode() + code


def read_record(path: Path) -> Record:
    """The record of a frozen file.

    Raises:
        ConfigError: the file cannot be read, or has no record or a damaged one.
    """
    try:
        lines = path.read_text(encoding="utf-8").split("\n")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"cannot read {path}: {error}") from error
    if _BEGIN not in lines or _END not in lines[lines.index(_BEGIN) :]:
        raise ConfigError(f"{path} has no record ({_BEGIN} ... {_END}); `rrmctl prior language add --help`")
    begin = lines.index(_BEGIN) + 1
    block = lines[begin : lines.index(_END, begin)]
    try:
        fields: dict[str, Any] = tomllib.loads("\n".join(line.removeprefix("#") for line in block))
        candidates = tuple(Candidate(**candidate) for candidate in fields.pop("candidates"))
        return Record(**fields, candidates=candidates)
    except (tomllib.TOMLDecodeError, TypeError, KeyError) as error:
        raise ConfigError(f"{path}: its record is damaged: {error}") from error


def _toml(fields: dict[str, Any]) -> list[str]:
    # JSON's strings and numbers are TOML's, surrogates aside.
    return [
        f"# {name} = {json.dumps(value, ensure_ascii=False)}" for name, value in fields.items() if value is not None
    ]
