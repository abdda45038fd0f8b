"""Which of several candidates is kept, and how it is frozen.

The paper keeps "the best-executing" of five. Here a candidate executes if it is within the subset, reads what the task
reveals, and gives a finite number for every step of a random walk, not always the same one. Among those that do, the
one is kept that most agrees with the others on which of two segments is better, as a preference would be put; the
first of equals. That is a vote, and needs no reward: the true one is never looked at.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from hashlib import sha256
from pathlib import Path
from typing import NamedTuple

import numpy as np

from rrm.envs.base import Doubles
from rrm.envs.tasks import Task, make
from rrm.errors import ConfigError, PriorError, RrmError
from rrm.files import make_folder, write_atomically
from rrm.priors.language import Candidate, Record, check_reads, freeze, read_source
from rrm.priors.language.translate import admit
from rrm.priors.step import PriorStep, Scene, evaluate_prior
from rrm.registry import LANGUAGE
from rrm.seeding import Streams
from rrm.types import Floats

_SEGMENT, _STRIDE = 50, 10  # steps; the paper's segments
_EPISODES = 4
_HELD = 25  # steps for which an action of every other episode is held: single ones cancel out and lead nowhere
_SECONDS = 60  # that a candidate may take for a walk; a single step always ends


class Walk(NamedTuple):
    """What was lived through on a walk at random: `N` episodes of `T` steps. The true reward is not kept."""

    obs: Floats  #: [N, T, O], before each step
    act: Floats  #: [N, T, A]
    outcomes: Doubles  #: [N, T, K], in the order of `Task.outcomes`


def freeze_best(
    task: Task, paths: Sequence[Path], folder: Path, *, model: str, date: str, prompt: str
) -> tuple[Path, Record]:
    """Try candidates and freeze the best of them as `folder/TASK.language.py`.

    `model`, `date`, `prompt`: where the candidates come from, as the user says; the prompt is the text that was sent. A
    `PriorError` says of each candidate why it does not execute, where none does.
    """
    target = folder / f"{task.name}{LANGUAGE}"
    if target.exists():
        raise ConfigError(f"{target} is frozen; move it away, or name another folder")
    for text in (model, date, *(path.name for path in paths)):
        if not text.strip() or not text.isprintable():
            raise ConfigError(f"{text!r} cannot stand in a record; use printable text")
    if len({path.name for path in paths}) < len(paths):
        raise ConfigError("two candidates have the same file name; the record tells them apart by it")
    codes = {path.name: read_source(path) for path in paths}
    candidates = try_out(task, codes, walk(task))
    kept = best(candidates)
    if kept is None:
        raise PriorError("no candidate can be used:\n" + "\n".join(f"  {c.refused}" for c in candidates))
    record = Record(
        task=task.name, model=model, date=date, prompt_sha256=sha256(prompt.encode()).hexdigest(),
        kept=candidates[kept].file, candidates=tuple(candidates),
    )  # fmt: skip
    content = freeze(record, codes[record.kept])
    admit(content, str(target))
    make_folder(folder)
    write_atomically(target, content)
    return target, record


def try_out(task: Task, codes: Mapping[str, bytes], lived: Walk) -> list[Candidate]:
    """What becomes of each file's code: a reason against it, or a score where there are others to agree with."""
    sums: dict[str, Doubles] = {}
    refused: dict[str, str] = {}
    for file, code in codes.items():
        try:
            admitted = admit(code, file)
            check_reads(admitted, task)
            said = values(admitted.function(), task, lived, file)
            if np.ptp(said) == 0:
                raise PriorError(f"{file}: says {said.flat[0]:g} of every step")
            sums[file] = segment_sums(said)
        except RrmError as error:
            refused[file] = str(error)
    candidates = []
    for file, code in codes.items():
        agreed = [agreement(sums[file], sums[other]) for other in sums if file in sums and other != file]
        score = round(float(np.mean(agreed)), 4) if agreed else None
        digest = sha256(code).hexdigest()
        candidates.append(Candidate(file=file, sha256=digest, refused=refused.get(file), score=score))
    return candidates


def best(candidates: Sequence[Candidate]) -> int | None:
    """Position of the candidate to keep; None where all are refused."""
    there = [index for index, candidate in enumerate(candidates) if candidate.refused is None]
    return max(there, key=lambda index: candidates[index].score or 0.0, default=None)


def walk(task: Task) -> Walk:
    """Full episodes of uniform actions, fresh ones at every step and held ones in turn; always the same for a task."""
    rng = Streams(0).numpy("language")
    env = make(task.name)
    obs = np.empty((_EPISODES, task.horizon, task.spaces.obs), np.float32)
    outcomes = np.empty((_EPISODES, task.horizon, len(task.outcomes)))
    drawn = rng.uniform(-1.0, 1.0, (_EPISODES, task.horizon, task.spaces.act)).astype(np.float32)
    drawn[1::2] = drawn[1::2, np.arange(task.horizon) // _HELD]
    try:
        for episode in range(_EPISODES):
            seen, _ = env.reset(seed=int(rng.integers(2**31)))
            for step in range(task.horizon):
                obs[episode, step] = seen
                seen, _, _, _, info = env.step(drawn[episode, step])
                outcomes[episode, step] = [info[name] for name in task.outcomes]
    finally:
        env.close()
    return Walk(obs, drawn, outcomes)


def values(
    prior: Callable[[PriorStep], float], task: Task, lived: Walk, name: str, seconds: float = _SECONDS
) -> Doubles:
    """The prior's value of every step, as a run would show it, float64 [N, T]; a `PriorError` where it is too slow."""
    rng = np.random.default_rng(0)  # part of a step, and out of the code's reach
    result = np.empty(lived.outcomes.shape[:2])
    end = time.monotonic() + seconds
    with warnings.catch_warnings(action="ignore"):  # of numpy, about numbers that are seen to be finite here
        for episode, step in np.ndindex(result.shape):
            obs, outcomes = lived.obs[episode], lived.outcomes[episode, step].tolist()
            info = dict(zip(task.outcomes, outcomes, strict=True))
            seen = PriorStep(task, obs[step], lived.act[episode, step], info, rng, Scene(task, obs[0]))
            result[episode, step] = evaluate_prior(prior, seen, f"{name} at step {step}")
            if time.monotonic() > end:
                count = step + 1 + episode * len(obs)
                raise PriorError(f"{name}: too slow, {count:,} steps took more than {seconds:g} s")
    return result


def segment_sums(values: Doubles) -> Doubles:
    """Sums over segments within an episode, float64 [S], of values [N, T] of single steps."""
    sums = np.lib.stride_tricks.sliding_window_view(values, _SEGMENT, axis=1).sum(-1)
    apart: Doubles = sums[:, ::_STRIDE].ravel()
    return apart


def agreement(first: Doubles, second: Doubles) -> float:
    """Share of pairs of segments that two [S] of sums order alike, in [0, 1]; where one calls them equal, a half."""
    pairs = np.triu_indices(len(first), k=1)
    orders = [np.sign(sums[pairs[0]] - sums[pairs[1]]) for sums in (first, second)]
    return float((1 + orders[0] * orders[1]).mean() / 2)
