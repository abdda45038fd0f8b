"""Which of several candidates is kept, and how it is frozen.

The paper keeps "the best-executing" of five. Here a candidate executes if it is within the subset, reads what the task
reveals, and gives a finite number for every step of a random walk, not always the same one. Among those that do, the
one is kept that most agrees with the others on which of two segments is better, as a preference would be put; the
first of equals. That is a vote, and needs no reward: the true one is never looked at.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rrm.envs.tasks import Task
from rrm.errors import ConfigError, PriorError, RrmError
from rrm.files import make_folder, write_atomically
from rrm.priors.language import check_reads
from rrm.priors.language.record import Candidate, Record, freeze, read_source, sha256
from rrm.priors.language.rollout import Doubles, Walk, values, walk
from rrm.priors.language.translate import admit
from rrm.registry import LANGUAGE

_SEGMENT, _STRIDE = 50, 10  # steps; the paper's segments


@dataclass(frozen=True)
class Origin:
    """What the user says of where the candidates come from."""

    model: str
    date: str
    prompt: str  #: the text that was sent


def add(task: Task, paths: Sequence[Path], origin: Origin, folder: Path) -> tuple[Path, Record]:
    """Try candidates and freeze the best of them as `folder/TASK.language.py`.

    Raises:
        ConfigError: a file cannot be read, or there is a frozen prior already.
        PriorError: no candidate executes; says why, for each.
    """
    target = folder / f"{task.name}{LANGUAGE}"
    if target.exists():
        raise ConfigError(f"{target} is frozen; move it away, or name another folder")
    for text in (origin.model, origin.date, *(path.name for path in paths)):
        if not text.strip() or not text.isprintable():
            raise ConfigError(f"{text!r} cannot stand in a record; use printable text")
    if len({path.name for path in paths}) < len(paths):
        raise ConfigError("two candidates have the same file name; the record tells them apart by it")
    codes = [read_source(path) for path in paths]
    candidates = judge(task, paths, codes, walk(task))
    kept = best(candidates)
    if kept is None:
        raise PriorError("no candidate can be used:\n" + "\n".join(f"  {c.refused}" for c in candidates))
    record = Record(
        task=task.name, model=origin.model, date=origin.date, prompt_sha256=sha256(origin.prompt.encode()),
        kept=paths[kept].name, candidates=tuple(candidates),
    )  # fmt: skip
    content = freeze(record, codes[kept])
    admit(content, str(target))
    make_folder(folder)
    write_atomically(target, content)
    return target, record


def judge(task: Task, paths: Sequence[Path], codes: Sequence[bytes], lived: Walk) -> list[Candidate]:
    """What becomes of each candidate: a reason against it, or a score where there are others to agree with."""
    sums: dict[int, Doubles] = {}
    refused: dict[int, str] = {}
    for index, (path, code) in enumerate(zip(paths, codes, strict=True)):
        try:
            admitted = admit(code, path.name)
            check_reads(admitted, task)
            said = values(admitted.function(), task, lived, path.name)
            if np.ptp(said) == 0:
                raise PriorError(f"{path.name}: says {said.flat[0]:g} of every step")
            sums[index] = segment_sums(said)
        except RrmError as error:
            refused[index] = str(error)
    return [
        Candidate(
            file=path.name, sha256=sha256(code), refused=refused.get(index),
            score=_score(index, sums) if index in sums else None,
        )
        for index, (path, code) in enumerate(zip(paths, codes, strict=True))
    ]  # fmt: skip


def best(candidates: Sequence[Candidate]) -> int | None:
    """Position of the candidate to keep; None where all are refused."""
    there = [index for index, candidate in enumerate(candidates) if candidate.refused is None]
    return max(there, key=lambda index: candidates[index].score or 0.0, default=None)


def segment_sums(values: Doubles) -> Doubles:
    """Sums over segments within an episode, float64 [S], of values [N, T] of single steps."""
    sums = np.lib.stride_tricks.sliding_window_view(values, _SEGMENT, axis=1).sum(-1)
    apart: Doubles = sums[:, ::_STRIDE].ravel()
    return apart


def agreement(first: Doubles, second: Doubles) -> float:
    """Share of pairs of segments that both order alike, in [0, 1]; a pair that one of them calls equal counts half.

    Args:
        first, second: sums over the same segments, [S].
    """
    pairs = np.triu_indices(len(first), k=1)
    orders = [np.sign(sums[pairs[0]] - sums[pairs[1]]) for sums in (first, second)]
    return float((1 + orders[0] * orders[1]).mean() / 2)


def _score(index: int, sums: dict[int, Doubles]) -> float | None:
    others = [agreement(sums[index], sums[other]) for other in sums if other != index]
    return round(float(np.mean(others)), 4) if others else None
