"""One child process: started in its own process group, listened to, and its end put into words."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from rrm.environ import environment
from rrmctl.running.scheduler import Ending, Outcome
from rrmctl.running.worker import WorkerExit
from rrmctl.store.files import storage_error
from rrmctl.store.layout import Layout
from rrmctl.store.status import ErrorKind, RunError

#: How a worker is started.
WORKER = (sys.executable, "-m", "rrmctl.running.worker")

#: Variables from which libraries take their number of threads when they are imported.
_THREAD_VARIABLES = (
    "OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMEXPR_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"
)  # fmt: skip


_UNHEARD: dict[int, tuple[ErrorKind, str]] = {
    WorkerExit.STORAGE: (ErrorKind.STORAGE, "the results folder took no write"),
    WorkerExit.REFUSED: (ErrorKind.REFUSED, "it cannot be run"),
    WorkerExit.WAITING: (ErrorKind.WAITING, "something from outside"),
    WorkerExit.MISSING: (ErrorKind.MISSING, "a file that it was planned with is not there"),
}


#: Signals that people and their tools send; the others come from what the process did itself.
_SENT = frozenset({signal.SIGKILL, signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGQUIT})


class Child:
    """The worker of one run. Its output goes to the run's log.

    Args:
        layout: the results root.
        job: the run's id.
        threads: it may use.
        options: further arguments of the worker.
        command: the program, to which root, id and options are added.
        clock: of `heard`, in seconds.

    Raises:
        StorageError: the log cannot be opened.
        OSError: the system starts no further process.
    """

    def __init__(
        self,
        layout: Layout,
        job: str,
        *,
        threads: int,
        options: Sequence[str] = (),
        command: Sequence[str] = WORKER,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.job = job
        self._clock = clock
        self.heard = clock()  #: when the last message arrived
        self.error: RunError | None = None  #: as the worker told it
        self.ended_for: RunError | None = None  #: why its parent ended it
        self.open = True  #: its pipe is
        self._text = b""  # of a line that is not complete
        self._memory_kills = _killed_for_memory()
        reading, writing = os.pipe()
        try:
            # Absolute: code of the user's may change the folder.
            order = [*command, str(layout.root.absolute()), job, *options]
            self._process = _start(layout, job, order, writing, threads)
        except BaseException:
            os.close(reading)
            raise
        finally:
            os.close(writing)
        os.set_blocking(reading, False)
        self._pipe = reading

    def fileno(self) -> int:
        """The descriptor that messages arrive on, for selectors."""
        return self._pipe

    def messages(self) -> list[dict[str, Any]]:
        """What has arrived since the last call, whole lines only. Closes the pipe at its end."""
        messages: list[dict[str, Any]] = []
        while self.open:
            try:
                data = os.read(self._pipe, 65536)
            except BlockingIOError:
                break
            if not data:
                self.close()
                break
            self.heard = self._clock()
            *lines, self._text = (self._text + data).split(b"\n")
            messages += map(_message, lines)
        return messages

    def close(self) -> None:
        """Stop listening."""
        if self.open:
            self.open = False
            os.close(self._pipe)

    def ended(self) -> bool:
        """True once the process is gone; what it had started is ended with it."""
        if not self._over():
            return False
        self.kill()
        self._process.wait()
        return True

    def _over(self) -> bool:
        """Whether the process has ended. It is not reaped by that: until it is no other group can have its number."""
        with contextlib.suppress(AttributeError, ChildProcessError):  # macOS; who started us ignores SIGCHLD
            return os.waitid(os.P_PID, self._process.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None
        return self._process.poll() is not None

    def ask_to_stop(self) -> None:
        """Have it checkpoint and leave."""
        self._signal(os.kill, signal.SIGTERM)

    def kill(self) -> None:
        """End it, and whatever it has started, now."""
        self._signal(os.killpg, signal.SIGKILL)

    def _signal(self, send: Callable[[int, int], None], number: signal.Signals) -> None:
        if self._process.returncode is None:  # its number is still its own
            with contextlib.suppress(ProcessLookupError, PermissionError):  # nobody is left in the group
                send(self._process.pid, number)

    def memory(self) -> int | None:
        """Resident memory in bytes; None where the system has no /proc, or the process is gone."""
        try:
            pages = int(Path(f"/proc/{self._process.pid}/statm").read_text().split()[1])
        except (OSError, IndexError):
            return None
        return pages * os.sysconf("SC_PAGE_SIZE")

    def end(self, kind: ErrorKind, reason: str) -> None:
        """Kill it for this reason."""
        if self.ended_for is None:
            self.ended_for = RunError(kind=kind, type=kind.capitalize(), message=f"{reason} and was ended")
            self.kill()

    def wait(self) -> None:
        """Wait for its end."""
        self._process.wait()
        self.close()

    def outcome(self, *, stopping: bool) -> Outcome:
        """How the attempt ended, once it has.

        Args:
            stopping: workers had been asked to leave, and may have been ended for taking too long.
        """
        code = self._process.returncode
        endings: dict[int, Ending] = {
            WorkerExit.DONE: Ending.DONE, WorkerExit.STOPPED: Ending.STOPPED, WorkerExit.LOCKED: Ending.ELSEWHERE
        }  # fmt: skip
        if code in endings:
            return Outcome(endings[code])
        if self.error is None and stopping and -code in (signal.SIGKILL, signal.SIGTERM):
            return Outcome(Ending.STOPPED)  # too slow to leave, or not begun; its last checkpoint holds
        return Outcome(Ending.FAILED, self.error or self._unspoken(code))

    def _unspoken(self, code: int) -> RunError:
        """Why a worker is gone that could not say so itself."""
        if self.ended_for is not None:
            return self.ended_for
        if code in _UNHEARD:  # its message was lost, as the pipe was full
            kind, told = _UNHEARD[code]
            return RunError(kind=kind, type=kind.capitalize(), message=f"{told}; its log says more")
        if code >= 0:
            return RunError(kind=ErrorKind.CRASHED, type="Exit", message=f"left with exit code {code}")
        kind, told = ErrorKind.CRASHED, f"killed by signal {-code}"
        if -code == signal.SIGKILL and _killed_for_memory() > self._memory_kills:
            kind, told = ErrorKind.MEMORY, "killed by the system for want of memory"
        elif -code in _SENT:
            kind, told = ErrorKind.KILLED, f"{told} from outside"
        return RunError(kind=kind, type=_signal_name(-code), message=told)


def _killed_for_memory() -> int:
    """Processes that the system has ended for want of memory since it was started; 0 where it does not say."""
    try:
        counts = dict(line.split() for line in Path("/proc/vmstat").read_text().splitlines())
        return int(counts["oom_kill"])
    except (OSError, ValueError, KeyError):
        return 0


def _message(line: bytes) -> dict[str, Any]:
    """A line from the pipe; one that is not a message is passed on for people to read rather than end the sweep."""
    try:
        message = json.loads(line)
    except ValueError:
        message = None
    return message if isinstance(message, dict) and "event" in message else {"event": "note", "text": repr(line)}


def worker_environment(threads: int, base: Mapping[str, str] = os.environ) -> dict[str, str]:
    """The environment of a worker: threads limited, and a log that can take any message, whatever the locale."""
    log = {"PYTHONUNBUFFERED": "1", "PYTHONIOENCODING": "utf-8:backslashreplace"}
    return environment(base) | dict.fromkeys(_THREAD_VARIABLES, str(threads)) | log


def _start(layout: Layout, job: str, command: list[str], pipe: int, threads: int) -> subprocess.Popen[bytes]:
    path = layout.run(job).log
    try:
        log = path.open("ab")
    except OSError as error:
        raise storage_error(path, error) from error
    with log:
        return subprocess.Popen(
            [*command, "--pipe", str(pipe), "--parent", str(os.getpid())],
            stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT, pass_fds=(pipe,),
            start_new_session=True, env=worker_environment(threads),
        )  # fmt: skip


def _signal_name(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"
