"""NVIDIA's Multi-Process Service: the processes on a card work on it at the same time, instead of in turns.

Its daemon is the command's own: it is found by nobody else's processes, and ends with the command.
"""

from __future__ import annotations

import contextlib
import shutil
import signal
import subprocess
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from rrm.environ import environment
from rrmctl.errors import UserError
from rrmctl.running.cards import VISIBLE

_CONTROL = "nvidia-cuda-mps-control"

#: How long the daemon may take to answer, seconds.
_PATIENCE_S = 30.0


def client_names(cards: Sequence[str]) -> list[str]:
    """What its clients call these cards: the daemon counts those that it was started on; others keep their names."""
    return [str(at) if name.isdecimal() else name for at, name in enumerate(cards)]


@contextlib.contextmanager
def service(cards: Sequence[str]) -> Iterator[dict[str, str]]:
    """A daemon for these cards, by their names in `CUDA_VISIBLE_DEVICES`; it is asked to leave at the end.

    Yields the variables by which processes find it. UserError: it is not installed, or does not start.
    """
    control = shutil.which(_CONTROL)
    if control is None:
        missing = f"--mps needs {_CONTROL}, which is not on this machine"
        raise UserError(missing, "NVIDIA's driver brings it; or leave --mps out")
    with tempfile.TemporaryDirectory(prefix="rrmctl-mps-") as folder:
        own = {"CUDA_MPS_PIPE_DIRECTORY": f"{folder}/pipe", "CUDA_MPS_LOG_DIRECTORY": f"{folder}/log"}
        for place in own.values():
            Path(place).mkdir()
        _ask([control, "-d"], own | {VISIBLE: ",".join(cards)})
        try:
            yield own
        finally:
            before = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT, signal.SIGTERM))  # else it would stay
            with contextlib.suppress(UserError):  # it has ended by itself
                _ask([control], own, said="quit\n")
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _ask(command: Sequence[str], variables: Mapping[str, str], said: str = "") -> None:
    """Run it to its end; the daemon itself outlives that, in a session of its own, which Ctrl-C does not reach."""
    try:
        with tempfile.TemporaryFile("w+") as told:  # no pipe: the daemon would keep it open
            code = subprocess.run(
                command, env=environment() | dict(variables), input=said, text=True, timeout=_PATIENCE_S, check=False,
                stdout=told, stderr=told, start_new_session=True,
            ).returncode  # fmt: skip
            told.seek(0)
            words = told.read().strip().splitlines()
    except (OSError, subprocess.TimeoutExpired) as error:
        code, words = 1, [str(error)]
    if code:
        raise UserError(f"--mps: {_CONTROL} fails: {words[-1] if words else f'exit code {code}'}", "leave --mps out")
