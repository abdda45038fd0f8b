"""Frozen language priors: files `NAME.language.py` that hold a function and where it came from.

The record is a block of comments at the top, TOML behind `# `, so that code and provenance are one file, with one
digest. Code in such a file is never run as a module: `rrm.priors.language.load` admits it or refuses it.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from rrm.errors import ConfigError
from rrm.files import read_bounded
from rrm.toml import loads

LARGEST = 200_000  #: bytes of a file with a candidate or a frozen prior
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


def read_source(path: Path) -> bytes:
    """What is in the file of a candidate or a frozen prior.

    Raises:
        ConfigError: it cannot be read, is no regular file or larger than `LARGEST`.
    """
    try:
        return read_bounded(path, LARGEST)
    except OSError as error:
        raise ConfigError(f"cannot read {path}: {error.strerror}") from error


def parse_record(source: bytes, path: Path) -> Record:
    """The record at the top of a frozen file's content.

    Raises:
        ConfigError: it has none, or a damaged one.
    """
    lines = source.decode(errors="replace").split("\n")
    if _BEGIN not in lines or _END not in lines[lines.index(_BEGIN) :]:
        raise ConfigError(f"{path} has no record ({_BEGIN} ... {_END}); `rrmctl prior language add --help`")
    begin = lines.index(_BEGIN) + 1
    block = lines[begin : lines.index(_END, begin)]
    try:
        fields: dict[str, Any] = loads("\n".join(line.removeprefix("#") for line in block))
        candidates = tuple(Candidate(**candidate) for candidate in fields.pop("candidates"))
        return Record(**fields, candidates=candidates)
    except (ValueError, TypeError, KeyError) as error:
        raise ConfigError(f"{path}: its record is damaged: {error}") from error


def _toml(fields: dict[str, Any]) -> list[str]:
    # JSON's strings and numbers are TOML's, surrogates aside.
    return [
        f"# {name} = {json.dumps(value, ensure_ascii=False)}" for name, value in fields.items() if value is not None
    ]
