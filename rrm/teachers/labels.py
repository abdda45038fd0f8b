"""The answers of people, one row each: `labels.parquet` in a run's folder. Undone ones stay.

A query's answer is its newest row that is not undone. Runs read sealed rows alone: those of a session all of whose
queries are answered, after a time of grace in which the last of them could be undone. Whoever collects answers alone
writes the file.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import asdict, dataclass, fields
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rrm.errors import LabelError
from rrm.files import UnfitFileError, place, read_bounded
from rrm.parquet import read_table, write_table

if TYPE_CHECKING:
    import pyarrow as pa

FILE = "labels.parquet"
VERSION = 1
_VERSION_KEY = b"rrm.labels_version"
_LARGEST = 1 << 30  # bytes

FIRST, SECOND, EQUAL, SKIPPED = 0, 1, -1, -2

#: What an answer is for; only the first trains. `practice`: the right one is obvious; `shared`: everybody is asked the
#: same; `repeat`: a pair of this person's again, its sides changed.
TRAIN, PRACTICE, SHARED, REPEAT = PURPOSES = ("train", "practice", "shared", "repeat")


@dataclass(frozen=True, kw_only=True)
class Label:
    """One answer of a person. Columns of the file are these, in this order."""

    run: str  #: whose query it was; "" of practice and of shared queries that no run asked
    step: int  #: environment step before which it was asked
    index: int  #: among the run's queries, from 0
    query: str  #: its id
    first: str  #: ids of the segments, see `rrm.teachers.published.segment_id`
    second: str
    answer: int  #: FIRST or SECOND is better, EQUAL, or SKIPPED
    shown_left: int  #: which of the two stood on the left: FIRST or SECOND
    return_first: float  #: true returns
    return_second: float
    return_shown: bool  #: whether the person saw them
    annotator: str
    purpose: str  #: one of PURPOSES
    latency_ms: float  #: from the first frame to the key
    loops: float  #: times that the clips were played until then
    speed: float  #: of playback, 1 is the usual one
    input: str  #: "key", "pointer", or what else gave the answer
    shown_at: float  #: when both clips were first seen, seconds since the epoch
    at: float  #: when it was written down, likewise
    undone: bool = False
    sealed: bool = False
    session: str = ""  #: of the person: one sitting at one page
    tool: str = ""  #: what showed the clips, with its version
    camera: str = ""  #: digest of how they were drawn


_TYPES = {"str": "string", "int": "int64", "float": "float64", "bool": "bool_"}


def schema() -> pa.Schema:
    """Of the file."""
    import pyarrow as pa

    columns = [(field.name, getattr(pa, _TYPES[str(field.type)])()) for field in fields(Label)]
    return pa.schema(columns, metadata={_VERSION_KEY: str(VERSION).encode()})


def read_labels(path: Path) -> list[Label]:
    """Every answer in a file, oldest first; none where there is no file. A `LabelError` where it is none of ours."""
    import pyarrow as pa

    try:
        table = read_table(read_bounded(path, _LARGEST))
    except FileNotFoundError:
        return []
    except (pa.ArrowException, UnfitFileError, OSError, ValueError) as error:
        raise LabelError(f"{path} cannot be read as labels: {error}") from error
    version = (table.schema.metadata or {}).get(_VERSION_KEY, b"none").decode(errors="replace")
    if version != str(VERSION) or table.schema.remove_metadata() != schema().remove_metadata():
        raise LabelError(f"{path} does not hold labels as this version knows them (version {version}, not {VERSION})")
    return [Label(**row) for row in table.to_pylist()]


def write_labels(path: Path, labels: Iterable[Label]) -> None:
    """Replace the file, durably; readers of the old one are not disturbed."""
    import pyarrow as pa

    write_table(path, pa.Table.from_pylist([asdict(label) for label in labels], schema=schema()))


def live(labels: Iterable[Label]) -> dict[tuple[int, int], Label]:
    """The answer that counts for each training query, by (step, index)."""
    return {(label.step, label.index): label for label in labels if label.purpose == TRAIN and not label.undone}


def digest(labels: Iterable[Label]) -> str:
    """Sixteen hex digits for what runs would learn from these: run, step, index, query and answer of what is sealed."""
    told = sorted(
        (label.run, label.step, label.index, label.query, label.answer) for label in labels if _teaches(label)
    )
    return hashlib.sha256(repr(told).encode()).hexdigest()[:16]


def answers_digest(path: Path) -> str:
    """`digest` of a file; a `LabelError` where there is none."""
    return _summary(path)[0]


def answered_runs(path: Path) -> frozenset[str]:
    """The runs with answers in a file that they can learn from; raises likewise."""
    return _summary(path)[1]


def _summary(path: Path) -> tuple[str, frozenset[str]]:
    try:
        stat = place(path).stat()
    except OSError as error:
        raise LabelError(f"cannot read the answers in {path}: {error.strerror}") from error
    return _summarised(place(path), stat.st_mtime_ns, stat.st_size)


@cache
def _summarised(path: Path, _changed: int, _size: int) -> tuple[str, frozenset[str]]:
    labels = [label for label in read_labels(path) if _teaches(label)]
    return digest(labels), frozenset(label.run for label in labels)


def _teaches(label: Label) -> bool:
    return label.purpose == TRAIN and label.sealed and not label.undone


def preference(label: Label) -> float:
    """The probability that the second segment is better, as `rrm.interfaces.Answer` has it: NaN of a skipped one."""
    known: dict[int, Any] = {FIRST: 0.0, SECOND: 1.0, EQUAL: 0.5, SKIPPED: float("nan")}
    return float(known[label.answer])
