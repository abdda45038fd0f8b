"""Language priors: reward functions that a language model wrote from a task's source, frozen before the run.

(Paper, section 3.2 and appendix "Language rewards".) The paper prints three functions, walker-walk's and those of the
two image-based tasks; they are here as printed. The others' are not published: those here are stand-ins, as their
records say.

A frozen prior is a file `NAME.language.py`: a function, and above it where it came from, a block of comments with TOML
behind `# `, so that code and provenance have one digest. A model's code is not trusted and never run as a module:
`translate` rebuilds what a small subset of Python allows and refuses the rest.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rrm.errors import ConfigError, RefusedCodeError
from rrm.files import place, read_bounded
from rrm.priors.language.translate import ENTRY, Admitted, admit
from rrm.priors.language.vocabulary import OUTCOMES, TASK_FEATURES
from rrm.registry import LANGUAGE
from rrm.toml import loads

if TYPE_CHECKING:
    from rrm.envs.tasks import Task
    from rrm.priors.step import PriorStep

FROZEN = Path(__file__).with_name("frozen")  #: one file a task

_LARGEST = 200_000  # bytes of a file with a candidate or a frozen prior
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


def language(step: PriorStep) -> float:
    """The frozen function of the step's task."""
    return _shipped(step.task.name)(step)


language.tasks = frozenset(path.name.removesuffix(LANGUAGE) for path in FROZEN.glob(f"*{LANGUAGE}"))  # type: ignore[attr-defined]


@cache
def _shipped(task: str) -> Callable[[PriorStep], float]:
    return load_frozen(f"{FROZEN / task}{LANGUAGE}:{ENTRY}")


def is_frozen(name: str) -> bool:
    """True for `path/to/NAME.language.py:reward`, code that is never run as a module of the user's."""
    return name.rpartition(":")[0].endswith(LANGUAGE)


def load_frozen(name: str) -> Callable[[PriorStep], float]:
    """The function in a frozen file, which sees nothing but `PriorStep` and the vocabulary.

    An `RrmError` where the code goes beyond the subset, or the file cannot be read or holds no record.
    """
    return _admitted(name)[0].function()


def check_frozen(name: str, task: Task) -> None:
    """Refuse, without running it, a frozen file that cannot be the prior of this task: written for another, say."""
    admitted, record = _admitted(name)
    if record.task != task.name:
        raise ConfigError(f'prior "{name}" was written for {record.task}, not for {task.name}')
    check_reads(admitted, task)


def check_reads(admitted: Admitted, task: Task) -> None:
    """Refuse code that reads what the task does not reveal, and say what it does."""
    hidden = sorted((admitted.reads & {*TASK_FEATURES, *OUTCOMES}) - {*task.reveals, *task.outcomes})
    if hidden:
        raise ConfigError(
            f"{admitted.where} reads {', '.join(hidden)}, which {task.name} does not reveal; it reveals: "
            f"{', '.join((*task.features, *task.outcomes))}"
        )


def _admitted(name: str) -> tuple[Admitted, Record]:
    location, _, function = name.rpartition(":")
    path = place(location)
    if function != ENTRY:
        raise RefusedCodeError(f'prior "{name}": a language prior is called {ENTRY}, as in {location}:{ENTRY}')
    source = read_source(path)
    return admit(source, str(path)), parse_record(source, path)


def read_source(path: Path) -> bytes:
    """What is in the file of a candidate or a frozen prior."""
    try:
        return read_bounded(path, _LARGEST)
    except OSError as error:
        raise ConfigError(f"cannot read {path}: {error.strerror}") from error


def parse_record(source: bytes, path: Path) -> Record:
    """The record at the top of a frozen file's content; a `ConfigError` where there is none, or a damaged one."""
    lines = source.decode(errors="replace").split("\n")
    if _BEGIN not in lines or _END not in lines[lines.index(_BEGIN) :]:
        raise ConfigError(f"{path} has no record ({_BEGIN} ... {_END}); `rrmctl prior language add --help`")
    begin = lines.index(_BEGIN) + 1
    block = lines[begin : lines.index(_END, begin)]
    try:
        fields = loads("\n".join(line.removeprefix("#") for line in block))
        candidates = tuple(Candidate(**candidate) for candidate in fields.pop("candidates"))
        return Record(**fields, candidates=candidates)
    except (ValueError, TypeError, KeyError) as error:
        raise ConfigError(f"{path}: its record is damaged: {error}") from error


def freeze(record: Record, code: bytes) -> bytes:
    """A file's content: the record, then the candidate's code as it was given."""
    fields = asdict(record)
    candidates = fields.pop("candidates")
    lines = [_BEGIN, *_toml(fields)]
    for candidate in candidates:
        lines += ["#", "# [[candidates]]", *_toml(candidate)]
    return "\n".join([*lines, _END, "", ""]).encode() + code


def _toml(fields: Mapping[str, Any]) -> list[str]:
    """JSON's strings and numbers are TOML's, surrogates aside."""
    texts = {name: json.dumps(value, ensure_ascii=False) for name, value in fields.items() if value is not None}
    return [f"# {name} = {text}" for name, text in texts.items()]
