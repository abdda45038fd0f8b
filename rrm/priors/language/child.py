"""A process of its own in which one candidate is tried: limited memory and time, no files, nothing to write to.

    python -m rrm.priors.language.child TASK FILE < walk > values

The standard output is JSON: the prior's value of every step, or why there are none.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from rrm.envs.tasks import Task
from rrm.envs.tasks import task as task_of
from rrm.errors import PriorError, RrmError
from rrm.priors.evaluate import evaluate_prior
from rrm.priors.language import guards  # noqa: F401  (translated code needs it when no file can be opened any more)
from rrm.priors.language.rollout import Doubles, Walk
from rrm.priors.language.translate import admit
from rrm.priors.step import PriorStep, Scene
from rrm.process import environment

SECONDS = 60  #: by the clock on the wall; of the processor likewise
_MEMORY = 4 << 30  # bytes of address space; libraries reserve much more of it than they use


def try_out(task: Task, path: Path, walk: Walk, seconds: float = SECONDS) -> Doubles:
    """The candidate's value of every step, float64 [N, T], computed by a process that can do nothing else.

    Raises:
        PriorError: the code is refused, fails, or does not end in time.
    """
    command = [sys.executable, "-m", "rrm.priors.language.child", task.name, str(path.absolute())]
    variables = environment({name: os.environ[name] for name in ("PATH", "PYTHONPATH") if name in os.environ})
    with tempfile.TemporaryDirectory() as empty:
        try:
            done = subprocess.run(
                command, input=walk.encode(), capture_output=True, timeout=seconds, check=False, cwd=empty,
                env=variables | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "PYTHONUTF8": "1"},
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            raise PriorError(f"{path.name}: not done after {seconds:g} s") from None
    if done.returncode:
        last = done.stderr.decode(errors="replace").strip().splitlines()[-1:]
        raise PriorError(f"{path.name}: its process ended with {done.returncode}: {''.join(last) or 'no message'}")
    answer = json.loads(done.stdout)
    if "error" in answer:
        raise PriorError(answer["error"])
    return np.array(answer["values"])


def _main() -> None:
    task, path = task_of(sys.argv[1]), Path(sys.argv[2])
    episodes = list(_steps(task, Walk.decode(sys.stdin.buffer.read())))
    answer: dict[str, Any]
    try:
        code = admit(path.read_bytes(), path.name)
        _limit()
        function = code.function()
        answer = {
            "values": [
                [evaluate_prior(function, step, f"{path.name} at step {number}") for number, step in enumerate(steps)]
                for steps in episodes
            ]
        }
    except RrmError as error:
        answer = {"error": str(error)}
    sys.stdout.write(json.dumps(answer))


def _steps(task: Task, walk: Walk) -> Iterator[list[PriorStep]]:
    """The steps of each episode, as a run would show them."""
    rng = np.random.default_rng(0)  # part of a step, and out of the code's reach
    for obs, act, outcomes in zip(walk.obs, walk.act, walk.outcomes, strict=True):
        first = Scene(task, obs[0])
        infos = [dict(zip(task.outcomes, told, strict=True)) for told in outcomes.tolist()]
        yield [PriorStep(task, *seen, rng, first) for seen in zip(obs, act, infos, strict=True)]


def _limit() -> None:
    """From here on: no more memory, time, open files, written bytes or processes than this."""
    for what, most in (
        (resource.RLIMIT_AS, _MEMORY),
        (resource.RLIMIT_CPU, SECONDS),
        (resource.RLIMIT_FSIZE, 0),
        (resource.RLIMIT_NOFILE, 0),
        (resource.RLIMIT_NPROC, 0),
        (resource.RLIMIT_CORE, 0),
    ):
        resource.setrlimit(what, (most, most))


if __name__ == "__main__":
    _main()
