"""The executor of this machine: one child process a run, each in its own process group, none able to take another down.

It waits for pipes and exit codes only, and ends what is silent for too long or takes too much memory.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from multiprocessing.connection import wait
from pathlib import Path
from types import MappingProxyType
from typing import Any

from rrm.environ import environment
from rrmctl.running.cards import NO_CARD, REPEATABLE, Cards
from rrmctl.running.config_file import on_card
from rrmctl.running.executor import Ended, Evaluated, Event, Note, Progress, Started, WorkOrder
from rrmctl.running.scheduler import Outcome, Stage
from rrmctl.running.worker import WorkerExit
from rrmctl.store.files import storage_error
from rrmctl.store.layout import Layout
from rrmctl.store.status import ErrorKind, RunError
from rrmctl.suspend_clock import WakingTime

#: Time between two looks at the memory of workers, seconds.
_POLL_S = 1.0

#: How a worker is started.
WORKER = (sys.executable, "-m", "rrmctl.running.worker")

#: Variables from which libraries take their number of threads when they are imported.
_THREAD_VARIABLES = (
    "OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMEXPR_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"
)  # fmt: skip

_ENDINGS: dict[int, Stage] = {
    WorkerExit.DONE: Stage.DONE, WorkerExit.STOPPED: Stage.STOPPED, WorkerExit.LOCKED: Stage.ELSEWHERE
}  # fmt: skip

#: What messages say, by the name of their event; their other entries are its fields.
_EVENTS: dict[str, Callable[..., Event]] = {"start": Started, "beat": Progress, "row": Evaluated, "note": Note}

_KINDS = frozenset(kind.value for kind in ErrorKind)

#: What is said of exit codes where the worker's message was lost, as the pipe was full.
_UNHEARD: dict[int, tuple[ErrorKind, str]] = {
    WorkerExit.STORAGE: (ErrorKind.STORAGE, "the results folder took no write"),
    WorkerExit.REFUSED: (ErrorKind.REFUSED, "it cannot be run"),
    WorkerExit.WAITING: (ErrorKind.WAITING, "something from outside"),
    WorkerExit.MISSING: (ErrorKind.MISSING, "a file that it was planned with is not there"),
}

#: Signals that people and their tools send; the others come from what the process did itself.
_SENT = frozenset({signal.SIGKILL, signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGQUIT})


class Child:
    """The worker of one run. Its output goes to the run's log; root, id and options are added to the command, and
    variables to its environment.

    Raises StorageError where the log cannot be opened, and OSError where the system starts no further process.
    """

    def __init__(
        self,
        layout: Layout,
        order: WorkOrder,
        command: Sequence[str] = WORKER,
        clock: Callable[[], float] = time.monotonic,
        variables: Mapping[str, str] = MappingProxyType({}),
    ) -> None:
        self.job = order.run
        self._clock = clock
        self.heard = clock()  #: when the last message arrived
        self.open = True  #: its pipe is
        self._taken_up = False  # as the worker told it
        self._error: RunError | None = None  # the same
        self._ended_for: RunError | None = None  # why its parent ended it
        self._text = b""  # of a line that is not complete
        self._memory_kills = _killed_for_memory()
        self.pipe, writing = os.pipe()  # descriptors; messages arrive on the first
        # Absolute: code of the user's may change the folder.
        words = [*command, str(layout.root.absolute()), order.run, *order.options]
        log = layout.run(order.run).log
        try:
            output = os.open(log, os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_CLOEXEC, 0o666)
        except OSError as error:
            os.close(self.pipe)
            os.close(writing)
            raise storage_error(log, error) from error
        try:
            self._process = subprocess.Popen(
                [*words, "--pipe", str(writing), "--parent", str(os.getpid())],
                stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT, pass_fds=(writing,),
                start_new_session=True, env=worker_environment(order.threads) | dict(variables),
            )  # fmt: skip
        except BaseException:
            os.close(self.pipe)
            raise
        finally:
            os.close(writing)
            os.close(output)
        os.set_blocking(self.pipe, False)

    def events(self) -> list[Event]:
        """What has arrived since the last call, whole lines only. Closes the pipe at its end."""
        events: list[Event] = []
        while self.open:
            try:
                data = os.read(self.pipe, 65536)
            except BlockingIOError:
                break
            if not data:
                self.close()
                break
            self.heard = self._clock()
            *lines, self._text = (self._text + data).split(b"\n")
            for line in lines:
                try:
                    message: Any = json.loads(line)
                except ValueError:
                    message = None
                match message:
                    case {"event": str(name), **fields} if name in _EVENTS:
                        events.append(self._event(name, fields, line))
                    case {"event": "error", "kind": kind, "type": name, "message": text} if kind in _KINDS:
                        self._error = RunError(kind=ErrorKind(kind), type=name, message=text)
                    case {"event": str(name)} if name != "error":
                        pass  # a sign of life and no more
                    case _:  # passed on for people to read rather than end the sweep
                        events.append(Note(self.job, repr(line)))
        return events

    def _event(self, name: str, fields: Mapping[object, Any], line: bytes) -> Event:
        try:
            event = _EVENTS[name](self.job, **fields)  # type: ignore[arg-type]  # JSON's keys are texts
        except TypeError:  # of a worker whose code is another by now
            return Note(self.job, repr(line))
        self._taken_up = self._taken_up or isinstance(event, Started)
        return event

    def close(self) -> None:
        """Stop listening."""
        if self.open:
            self.open = False
            os.close(self.pipe)

    def ended(self) -> bool:
        """True once the process is gone; what it had started is ended with it."""
        try:  # not reaped by this look: until it is no other group can have its number
            over = os.waitid(os.P_PID, self._process.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None
        except (AttributeError, ChildProcessError):  # macOS; who started us ignores SIGCHLD
            over = self._process.poll() is not None
        if over:
            self.kill()
            self._process.wait()
        return over

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
        if self._ended_for is None:
            self._ended_for = RunError(kind=kind, type=kind.capitalize(), message=f"{reason} and was ended")
            self.kill()

    def wait(self) -> None:
        """Wait for its end."""
        self._process.wait()
        self.close()

    def outcome(self, *, stopping: bool) -> Outcome:
        """How the attempt ended, once it has; where `stopping`, it may have been ended for taking too long."""
        code = self._process.returncode
        if code == WorkerExit.STOPPED and not stopping:
            reason = "it was asked to leave by somebody else, and is checkpointed"
            return Outcome(Stage.FAILED, RunError(kind=ErrorKind.KILLED, type="Stopped", message=reason))
        if code in _ENDINGS:
            return Outcome(_ENDINGS[code])
        if self._error is None and stopping and -code in (signal.SIGKILL, signal.SIGTERM):
            return Outcome(Stage.STOPPED)  # too slow to leave, or not begun; its last checkpoint holds
        names = {-number.value: number.name for number in signal.Signals}
        name, kind, reason = names.get(code, f"signal {-code}"), ErrorKind.CRASHED, f"killed by signal {-code}"
        if code in _UNHEARD:
            kind, reason = _UNHEARD[code]
            name, reason = kind.capitalize(), f"{reason}; its log says more"
        elif code >= 0:
            name, reason = "Exit", f"left with exit code {code}"
        elif -code == signal.SIGKILL and _killed_for_memory() > self._memory_kills:
            kind, reason = ErrorKind.MEMORY, "killed by the system for want of memory"
        elif -code in _SENT:
            kind, reason = ErrorKind.KILLED, f"{reason} from outside"
        error = self._error or self._ended_for or RunError(kind=kind, type=name, message=reason)
        return Outcome(Stage.FAILED, error, error.kind is ErrorKind.CRASHED and not self._taken_up)


@dataclass(kw_only=True)
class LocalExecutor:
    """An `rrmctl.running.executor.Executor`."""

    layout: Layout
    hang_after_s: float = 1800.0  #: silence after which a worker counts as hung; a feedback session may take minutes
    memory_limit: int | None = None  #: bytes that a worker may take; None: as much as there is
    cards: Cards | None = None  #: for runs on one; None: each takes the first that it finds
    command: Sequence[str] = WORKER
    _children: dict[str, Child] = field(default_factory=dict, init=False)
    _waking: WakingTime = field(default_factory=WakingTime, init=False)
    _stopping: bool = field(default=False, init=False)
    _weighed: float = field(default=0.0, init=False)  #: when the memory of workers was last looked at

    def submit(self, order: WorkOrder) -> None:
        try:
            variables = self._variables(order.run)
            self._children[order.run] = Child(self.layout, order, self.command, self._waking, variables)
        except BaseException:
            self._leave_card(order.run)
            raise

    def _variables(self, run: str) -> Mapping[str, str]:
        """Those by which the process of a run finds its card, or none."""
        if not on_card(self.layout.run(run)):
            return NO_CARD
        return REPEATABLE if self.cards is None else self.cards.take(run)

    def _leave_card(self, run: str) -> None:
        if self.cards is not None:
            self.cards.free(run)

    def events(self, wait_s: float) -> Iterator[Event]:
        speaking = {child.pipe: child for child in self._children.values() if child.open}
        for pipe in wait([*speaking], wait_s):
            yield from speaking[pipe].events()  # type: ignore[index]  # they come back as they were given
        self._end_misbehaving()
        for child in [child for child in self._children.values() if child.ended()]:
            yield from child.events()
            child.close()
            del self._children[child.job]
            self._leave_card(child.job)
            yield Ended(child.job, child.outcome(stopping=self._stopping))

    @property
    def running(self) -> int:
        return len(self._children)

    def stop(self, *, now: bool = False) -> None:
        self._stopping = True
        for child in self._children.values():
            child.kill() if now else child.ask_to_stop()

    def close(self) -> None:
        for child in self._children.values():
            child.kill()
        for child in self._children.values():
            child.wait()
            self._leave_card(child.job)
        self._children.clear()

    def memory(self) -> int:
        """Resident memory of all workers, in bytes; of those that the system tells of."""
        return sum(child.memory() or 0 for child in self._children.values())

    def _end_misbehaving(self) -> None:
        """End workers that are silent for too long, and those that take too much memory."""
        lived, now = self._waking(), time.monotonic()
        for child in self._children.values():
            if lived - child.heard > self.hang_after_s:
                child.end(ErrorKind.HUNG, "gave no sign of life")
        if self.memory_limit is None or now - self._weighed < _POLL_S:
            return
        self._weighed = now
        for child in self._children.values():
            memory = child.memory()
            if memory is not None and memory > self.memory_limit:
                taken, limit = (f"{size / 2**30:.2f} GiB" for size in (memory, self.memory_limit))
                child.end(ErrorKind.MEMORY, f"took {taken} of memory, {limit} are allowed,")


def _killed_for_memory() -> int:
    """Processes that the system has ended for want of memory since it was started; 0 where it does not say."""
    try:
        counts = dict(line.split() for line in Path("/proc/vmstat").read_text().splitlines())
        return int(counts["oom_kill"])
    except (OSError, ValueError, KeyError):
        return 0


def worker_environment(threads: int, base: Mapping[str, str] = os.environ) -> dict[str, str]:
    """The environment of a worker: threads limited, and a log that can take any message, whatever the locale."""
    log = {"PYTHONUNBUFFERED": "1", "PYTHONIOENCODING": "utf-8:backslashreplace"}
    return environment(base) | dict.fromkeys(_THREAD_VARIABLES, str(threads)) | log
