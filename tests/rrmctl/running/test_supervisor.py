"""Real processes that end, crash, hang and are killed; and what is left of the sweep."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
import re
import resource
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import pytest
from typer.testing import CliRunner

from rrmctl.cli.app import app
from rrmctl.errors import Exit
from rrmctl.running.local import LocalExecutor
from rrmctl.running.scheduler import Outcome, Stage
from rrmctl.running.supervisor import Supervisor, Terms
from rrmctl.store import load
from rrmctl.store.files import try_lock
from rrmctl.store.labels import OpenSession
from rrmctl.store.layout import Layout
from rrmctl.store.status import ErrorKind, RunState, log_tail, read_status, run_status, write_status
from rrmctl.store.sweeps import Job
from tests.rrmctl.running.standin import COMMAND, expected, prepare

#: A parent of its own: runs the sweep in argv[1] with argv[2] workers, and leaves with the pool's code.
PARENT = """
import sys
from pathlib import Path
from tests.rrmctl.running.standin import COMMAND, prepare
from tests.rrmctl.running.test_supervisor import Record
from rrmctl.running.local import LocalExecutor
from rrmctl.running.supervisor import Supervisor
root, (jobs, slots, steps, lease_s) = Path(sys.argv[1]), map(int, sys.argv[2:])
layout, assigned = prepare(root, range(jobs), steps)
sys.exit(Supervisor(
    layout=layout, jobs=assigned, slots=slots, watcher=Record(), lease_s=lease_s,
    executor=LocalExecutor(layout=layout, command=COMMAND),
).run())
"""


class Record:
    """Keeps what the pool tells."""

    def __init__(self) -> None:
        self.starts: Counter[str] = Counter()
        self.phases: dict[str, Stage] = {}
        self.errors: list[str] = []
        self.notes: list[str] = []

    def started(self, job: str, attempt: int) -> None:
        self.starts[job] += 1

    def beat(self, job: str, step: int, steps_per_s: float | None) -> None:
        pass

    def row(self, job: str, step: int, success: float | None, true_return: float | None) -> None:
        pass

    def note(self, job: str, text: str) -> None:
        self.notes.append(text)

    def ended(self, job: str, outcome: Outcome, phase: Stage) -> None:
        self.phases[job] = phase
        if outcome.error is not None:
            self.errors.append(str(outcome.error))

    def stopping(self, workers: int, wait_s: float) -> None:
        pass

    def asked(self, sessions: Sequence[OpenSession]) -> None:
        pass

    def tick(self) -> None:
        pass


@pytest.fixture
def behave(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Say what the run of a seed does, as `behave(s0="crash", other="train")`."""

    def set_(**behaviours: str) -> None:
        monkeypatch.setenv("STANDIN", json.dumps({name.removeprefix("s"): what for name, what in behaviours.items()}))

    return set_


def pool(layout: Layout, assigned: list[Job], watcher: Record | None = None, **options: object) -> Supervisor:
    own = {name: options.pop(name) for name in ("hang_after_s", "memory_limit", "command") if name in options}
    executor = LocalExecutor(layout=layout, **({"command": COMMAND} | own))
    settings: dict[str, object] = {"slots": 3, "executor": executor} | options
    return Supervisor(layout=layout, jobs=assigned, watcher=watcher or Record(), **settings)


def states(layout: Layout, assigned: list[Job]) -> list[RunState]:
    return [run_status(layout.run(job.id)).state for job in assigned]


def attempts(layout: Layout, assigned: list[Job]) -> list[int]:
    return [read_status(layout.run(job.id)).attempt for job in assigned]


def rows(root: Path) -> list[tuple[int, int, float]]:
    """Seed, step and return of every row."""
    frame = load(root, "stand-in").sort_values(["seed", "step"])
    return list(frame[["seed", "step", "true_return"]].itertuples(index=False, name=None))


def alive(pid: int) -> bool:
    """Whether a process runs; one that is dead and not yet reaped does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


def until(condition: Callable[[], bool], seconds: float = 120.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "it did not happen in time"
        time.sleep(0.02)


@contextlib.contextmanager
def parent(root: Path, jobs: int, slots: int, steps: int = 40, lease_s: int = 30) -> Iterator[subprocess.Popen[bytes]]:
    """A pool in a process of its own."""
    command = [sys.executable, "-c", PARENT, *map(str, (root, jobs, slots, steps, lease_s))]
    with subprocess.Popen(command, cwd=Path(__file__).parents[3]) as process:
        try:
            yield process
        finally:
            process.kill()


def stop_between_writes(pid: int) -> None:
    """SIGSTOP for a worker; in the middle of a write nobody could take its run over."""
    while True:
        os.kill(pid, signal.SIGSTOP)
        time.sleep(0.05)
        if not any(each.readlink().name == "guard" for each in Path(f"/proc/{pid}/fd").iterdir()):
            return
        os.kill(pid, signal.SIGCONT)
        time.sleep(0.03)


@contextlib.contextmanager
def meanwhile(action: Callable[[], None]) -> Iterator[None]:
    """Run `action` in a thread beside the block."""
    thread = threading.Thread(target=action)
    thread.start()
    yield
    thread.join()


def half_way(layout: Layout, assigned: list[Job]) -> list[int]:
    """Wait until these runs are half-way; their processes."""
    until(lambda: all((layout.run(job.id).path / "misbehaved").exists() for job in assigned))
    return [pid for job in assigned if (pid := read_status(layout.run(job.id)).pid) is not None]


def go(layout: Layout) -> None:
    """Open the gate."""
    (layout.root / "go").touch()


@pytest.mark.slow
def test_a_run_that_waits_gives_its_slot_to_the_others(tmp_path: Path, behave: Callable[..., None]) -> None:
    """Its process leaves, it is no failure, `status` says for what; once that has come, it goes on where it was."""
    behave(s0="wait")
    layout, assigned = prepare(tmp_path, range(2))
    watcher = Record()
    assert pool(layout, assigned, watcher, slots=1).run() is Exit.INCOMPLETE
    assert states(layout, assigned) == [RunState.WAITING, RunState.DONE]
    assert watcher.errors == ["3 answers of its teacher"]
    told = CliRunner().invoke(app, ["status", "--results", str(tmp_path)]).stdout
    assert "1 run waiting for 3 answers of its teacher" in told
    (tmp_path / "answers").touch()
    layout, again = prepare(tmp_path, range(1))
    later = Record()
    assert pool(layout, again, later).run() is Exit.DONE
    assert later.notes == ["from step 25"]
    assert attempts(layout, assigned) == [2, 1]
    assert rows(tmp_path) == expected(range(2))


@pytest.mark.slow
def test_every_job_is_run_once_and_recorded(tmp_path: Path) -> None:
    """More jobs than slots: all done at the first attempt, with every row, a log and no lock held."""
    layout, assigned = prepare(tmp_path, range(4))
    watcher = Record()
    assert pool(layout, assigned, watcher, asked=["rrmctl", "run"]).run() is Exit.DONE
    assert set(watcher.phases.values()) == {Stage.DONE}
    assert attempts(layout, assigned) == [1] * 4
    assert len(load(tmp_path, "stand-in")) == 4 * 4
    folder = layout.run(assigned[0].id)
    assert "done at step 40" in log_tail(folder)[-1]
    assert json.loads(folder.provenance.read_text())["argv"] == ["rrmctl", "run"]


@pytest.mark.slow
def test_running_a_finished_sweep_again_does_nothing(tmp_path: Path) -> None:
    """Even where the caller did not notice: what another process finished meanwhile is taken as it is."""
    layout, assigned = prepare(tmp_path, range(2))
    pool(layout, assigned).run()
    watcher = Record()
    assert pool(layout, assigned, watcher).run() is Exit.DONE
    assert not watcher.starts
    assert attempts(layout, assigned) == [1, 1]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("number", "error", "step"),
    [
        (signal.SIGKILL, "SIGKILL: killed by signal 9 from outside", 20),
        (signal.SIGTERM, "Stopped: it was asked to leave by somebody else, and is checkpointed", 25),
    ],
)
def test_a_killed_worker_costs_one_attempt_and_no_other_job(
    tmp_path: Path, behave: Callable[..., None], number: signal.Signals, error: str, step: int
) -> None:
    """Killed or asked to leave: that run goes on from its checkpoint, the others never notice, no row is lost."""
    behave(other="gate")
    layout, assigned = prepare(tmp_path, range(3))

    def kill() -> None:
        os.kill(pid := half_way(layout, assigned)[1], number)
        until(lambda: not alive(pid))
        go(layout)

    watcher = Record()
    with meanwhile(kill):
        assert pool(layout, assigned, watcher).run() is Exit.DONE
    assert attempts(layout, assigned) == [1, 2, 1]
    assert watcher.errors == [error]
    assert f"from step {step}" in watcher.notes
    assert rows(tmp_path) == expected(range(3))


def test_a_program_that_is_broken_fails_no_run(tmp_path: Path) -> None:
    """Workers that end before they take a run up, whichever it is: nothing is started any more, and nothing is lost."""
    layout, assigned = prepare(tmp_path, range(20))
    watcher = Record()
    command = (sys.executable, "-c", "raise ImportError('half written')")
    assert pool(layout, assigned, watcher, command=command).run() is Exit.INCOMPLETE
    assert set(states(layout, assigned)) == {RunState.QUEUED}
    assert set(watcher.errors) == {"Exit: left with exit code 1"}
    assert len(watcher.errors) < 6
    assert [note for note in watcher.notes if "nothing is started any more" in note]
    assert pool(layout, assigned).run() is Exit.DONE


@pytest.mark.parametrize(
    ("behaviour", "starts", "kind", "told"),
    [
        ("crash", 4, ErrorKind.CRASHED, "RuntimeError: boom"),
        ("exit", 4, ErrorKind.CRASHED, "Exit: left with exit code 0 before its end"),
        pytest.param("segfault", 4, ErrorKind.CRASHED, "SIGSEGV: killed by signal 11", marks=pytest.mark.slow),
        ("refuse", 1, ErrorKind.REFUSED, "PriorError: prior returned NaN at step 20"),
    ],
)
def test_a_failing_job_fails_alone_and_says_why(
    tmp_path: Path, behave: Callable[..., None], behaviour: str, starts: int, kind: ErrorKind, told: str
) -> None:
    """A crash is tried again twice without progress, a mistake never; the rows so far stay, the others are done."""
    behave(s1=behaviour)
    layout, assigned = prepare(tmp_path, range(3))
    watcher = Record()
    assert pool(layout, assigned, watcher).run() is Exit.FAILED
    assert states(layout, assigned) == [RunState.DONE, RunState.FAILED, RunState.DONE]
    status = read_status(layout.run(assigned[1].id))
    assert status.error is not None
    assert (watcher.starts[assigned[1].id], status.error.kind, str(status.error)) == (starts, kind, told)
    assert {told} == set(watcher.errors)
    assert len(load(tmp_path, "stand-in").query("seed == 1")) == 2
    if behaviour == "crash":
        assert "RuntimeError: boom" in log_tail(layout.run(assigned[1].id))


@pytest.mark.slow
def test_a_run_without_its_configuration_goes_on_once_that_is_there(tmp_path: Path) -> None:
    """It fails alone, with what to do; nothing is recorded that would keep the next command from running it."""
    layout, assigned = prepare(tmp_path, range(2))
    folder = layout.run(assigned[1].id)
    folder.config.unlink()
    watcher = Record()
    assert pool(layout, assigned, watcher).run() is Exit.FAILED
    assert states(layout, assigned) == [RunState.DONE, RunState.QUEUED]
    assert "config.json is missing (run its experiment again: `rrmctl run NAME` writes it anew)" in watcher.errors[0]
    prepare(tmp_path, range(2))
    assert pool(layout, assigned[1:], Record()).run() is Exit.DONE


@pytest.mark.slow
def test_a_crash_that_does_not_repeat_itself_is_overcome(tmp_path: Path, behave: Callable[..., None]) -> None:
    """The second attempt goes on from the checkpoint of the first."""
    behave(other="crash-once")
    layout, assigned = prepare(tmp_path, range(1))
    watcher = Record()
    assert pool(layout, assigned, watcher).run() is Exit.DONE
    assert watcher.notes == ["from step 0", "from step 20"]
    assert read_status(layout.run(assigned[0].id)).error is None


@pytest.mark.slow
def test_a_silent_worker_is_ended(tmp_path: Path, behave: Callable[..., None]) -> None:
    """One that shows no sign of life is ended and counts as hung."""
    behave(s0="hang")
    layout, assigned = prepare(tmp_path, range(2))
    watcher = Record()
    assert pool(layout, assigned, watcher, hang_after_s=12.0, retries=0).run() is Exit.FAILED
    assert states(layout, assigned) == [RunState.FAILED, RunState.DONE]
    assert {"Hung: gave no sign of life and was ended"} == set(watcher.errors)


def test_what_a_worker_has_started_dies_with_it(tmp_path: Path, behave: Callable[..., None]) -> None:
    """The process group goes, so that a killed worker leaves no simulator behind."""
    behave(other="orphan")
    layout, assigned = prepare(tmp_path, range(1))
    assert pool(layout, assigned, retries=0).run() is Exit.FAILED
    orphan = int((layout.run(assigned[0].id).path / "orphan").read_text())
    until(lambda: not alive(orphan))


@pytest.mark.slow
def test_a_system_that_starts_no_process_is_waited_for(tmp_path: Path) -> None:
    """No descriptors are left for a moment: nothing has failed, and all is done a little later."""
    layout, assigned = prepare(tmp_path, range(2))
    watcher, limits = Record(), resource.getrlimit(resource.RLIMIT_NOFILE)

    def relent() -> None:
        until(lambda: len(watcher.notes) == 2)
        resource.setrlimit(resource.RLIMIT_NOFILE, limits)

    working = pool(layout, assigned, watcher)
    with meanwhile(relent):
        resource.setrlimit(resource.RLIMIT_NOFILE, (len(list(Path("/proc/self/fd").iterdir())) + 2, limits[1]))
        assert working.run() is Exit.DONE
    assert all("Too many open files; trying again" in note for note in watcher.notes[:2])
    assert attempts(layout, assigned) == [1, 1]


@pytest.mark.slow
def test_a_full_disk_stops_the_sweep_and_says_so(tmp_path: Path, behave: Callable[..., None]) -> None:
    """Nothing has failed: the runs are interrupted, and the same command goes on when there is space."""
    behave(other="full")
    layout, assigned = prepare(tmp_path, range(3))
    watcher = Record()
    assert pool(layout, assigned, watcher, slots=1).run() is Exit.INCOMPLETE
    assert states(layout, assigned) == [RunState.INTERRUPTED, RunState.QUEUED, RunState.QUEUED]
    assert "checkpoint: No space left on device" in watcher.errors[0]
    assert "make space" in watcher.errors[0]
    behave(other="train")
    assert pool(layout, assigned).run() is Exit.DONE


@pytest.mark.slow
@pytest.mark.parametrize("numbers", [(signal.SIGINT,), (signal.SIGTERM, signal.SIGTERM)])
def test_one_signal_checkpoints_and_stops(
    tmp_path: Path, behave: Callable[..., None], numbers: Sequence[signal.Signals]
) -> None:
    """No worker is left, runs that had begun are interrupted, and a later pool ends them with the same rows; programs
    may say it again.
    """
    behave(other="gate")
    layout, assigned = prepare(tmp_path, range(3))
    pids: list[int] = []

    def interrupt() -> None:
        pids.extend(half_way(layout, assigned[:2]))
        for number in numbers:
            os.kill(os.getpid(), number)
            time.sleep(0.1)

    with meanwhile(interrupt):
        assert pool(layout, assigned, slots=2).run() is Exit.INCOMPLETE
    assert len(pids) == 2
    assert not any(map(alive, pids))
    assert states(layout, assigned) == [RunState.INTERRUPTED, RunState.INTERRUPTED, RunState.QUEUED]
    assert "interrupted at step 25" in log_tail(layout.run(assigned[0].id))[-1]
    go(layout)
    again = Record()
    assert pool(layout, assigned, again).run() is Exit.DONE
    assert Counter(again.notes) == {"from step 25": 2, "from step 0": 1}
    assert rows(tmp_path) == expected(range(3))


@pytest.mark.slow
def test_a_worker_that_will_not_leave_is_ended_in_time(tmp_path: Path, behave: Callable[..., None]) -> None:
    """After SIGTERM to the pool, one that hangs is killed when its time is up; its run is interrupted, not failed."""
    behave(other="hang")
    layout, assigned = prepare(tmp_path, range(1))

    def terminate() -> None:
        half_way(layout, assigned)
        os.kill(os.getpid(), signal.SIGTERM)

    with meanwhile(terminate):
        assert pool(layout, assigned, stop_after_s=0.5).run() is Exit.INCOMPLETE
    assert states(layout, assigned) == [RunState.INTERRUPTED]


@pytest.mark.slow
def test_a_second_signal_ends_everything_at_once(tmp_path: Path, behave: Callable[..., None]) -> None:
    """Exit code 130, and no process is left."""
    behave(other="hang")
    layout, assigned = prepare(tmp_path, range(2))
    pids: list[int] = []

    def interrupt_twice() -> None:
        pids.extend(half_way(layout, assigned))
        for _ in range(2):
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(0.3)

    with meanwhile(interrupt_twice):
        assert pool(layout, assigned).run() is Exit.INTERRUPTED
    assert len(pids) == 2
    assert not any(map(alive, pids))
    assert states(layout, assigned) == [RunState.INTERRUPTED] * 2


@pytest.mark.slow
def test_workers_whose_parent_is_killed_checkpoint_and_leave(tmp_path: Path, behave: Callable[..., None]) -> None:
    """SIGKILL of the parent leaves no orphan; the runs are interrupted and go on with the same rows."""
    behave(other="gate")
    layout, assigned = prepare(tmp_path, range(2))
    with parent(tmp_path, jobs=2, slots=2) as process:
        pids = half_way(layout, assigned)
        process.send_signal(signal.SIGKILL)
    until(lambda: not any(map(alive, pids)))
    assert states(layout, assigned) == [RunState.INTERRUPTED] * 2
    assert all("interrupted at step 25" in log_tail(layout.run(job.id))[-1] for job in assigned)
    go(layout)
    assert pool(layout, assigned).run() is Exit.DONE
    assert rows(tmp_path) == expected(range(2))


@pytest.mark.slow
def test_parents_on_one_folder_share_the_jobs(tmp_path: Path) -> None:
    """Two at once: both leave with 0 when all is done, and every job was begun once."""
    with parent(tmp_path, 8, 2) as one, parent(tmp_path, 8, 2) as two:
        assert [one.wait(), two.wait()] == [0, 0]
    layout, assigned = prepare(tmp_path, range(8))
    assert attempts(layout, assigned) == [1] * 8
    assert rows(tmp_path) == expected(range(8))


def children(pid: int) -> list[int]:
    return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


@pytest.mark.slow
def test_four_parents_of_which_one_is_killed_and_one_is_stopped(tmp_path: Path, behave: Callable[..., None]) -> None:
    """One with its workers, and another's workers for longer than a lease: the others end all jobs, none twice."""
    behave(other="gate")
    jobs, steps = 12, 100
    layout, assigned = prepare(tmp_path, range(jobs), steps)
    with contextlib.ExitStack() as stack:
        parents = [stack.enter_context(parent(tmp_path, jobs, 2, steps, lease_s=3)) for _ in range(4)]
        until(lambda: len(list(tmp_path.glob("runs/*/misbehaved"))) == 8)
        victims, sleepers = (children(each.pid) for each in parents[:2])
        for pid in sleepers:
            stop_between_writes(pid)
        for pid in (parents[0].pid, *victims):
            os.kill(pid, signal.SIGKILL)
        go(layout)
        assert [each.wait(120) for each in parents[2:]] == [0, 0]
        for pid in sleepers:
            os.kill(pid, signal.SIGCONT)
        assert parents[1].wait(60) == 0
    assert rows(tmp_path) == expected(range(jobs), steps)
    assert sum(attempts(layout, assigned)) <= jobs + 4
    for job in assigned:
        log = layout.run(job.id).log.read_text()
        assert len(re.findall(r"^--- done at step", log, re.MULTILINE)) == 1
    assert not any(map(alive, (*victims, *sleepers)))


@pytest.mark.slow
def test_the_survivor_takes_over_the_jobs_of_a_killed_parent(tmp_path: Path, behave: Callable[..., None]) -> None:
    """One of two parents is killed: the other waits until its workers have left and ends their runs."""
    behave(other="gate")
    layout, assigned = prepare(tmp_path, range(2))
    with parent(tmp_path, 2, 2) as one:
        half_way(layout, assigned)
        watcher = Record()

        def kill() -> None:
            until(lambda: list(watcher.phases.values()) == [Stage.ELSEWHERE] * 2)
            one.send_signal(signal.SIGKILL)
            go(layout)

        with meanwhile(kill):
            assert pool(layout, assigned, watcher).run() is Exit.DONE
    assert rows(tmp_path) == expected(range(2))


@pytest.mark.slow
def test_a_job_that_is_locked_is_waited_for_not_failed(tmp_path: Path) -> None:
    """As long as anybody holds a run it is theirs; once it is free it is run."""
    layout, assigned = prepare(tmp_path, range(2))
    folder = layout.run(assigned[0].id)
    lock = try_lock(folder.lock)
    assert lock is not None
    write_status(folder, dataclasses.replace(read_status(folder), state=RunState.RUNNING))
    watcher = Record()

    def release() -> None:
        ends = [Stage.ELSEWHERE, Stage.DONE]
        until(lambda: [watcher.phases.get(job.id) for job in assigned] == ends)
        os.close(lock)

    with meanwhile(release):
        assert pool(layout, assigned, watcher).run() is Exit.DONE
    assert watcher.phases == {job.id: Stage.DONE for job in assigned}


@pytest.mark.slow
def test_force_starts_from_nothing_once(tmp_path: Path, behave: Callable[..., None]) -> None:
    """What the run held is removed when its worker begins, and not again when that one is tried a second time."""
    layout, assigned = prepare(tmp_path, range(1))
    pool(layout, assigned).run()
    behave(other="crash-once")
    watcher = Record()
    terms = {assigned[0].id: Terms(attempt=1, fresh=True)}
    assert pool(layout, assigned, watcher, terms=terms).run() is Exit.DONE
    assert watcher.notes == ["from step 0", "from step 20"]
    assert attempts(layout, assigned) == [3]


@pytest.mark.slow
def test_a_stopped_worker_loses_its_run_and_discards_its_work(tmp_path: Path, behave: Callable[..., None]) -> None:
    """SIGSTOP of a worker: another parent ends its run after a lease; the worker wakes, writes nothing and leaves."""
    behave(other="gate")
    layout, assigned = prepare(tmp_path, range(1))
    with parent(tmp_path, 1, 1) as one:
        (pid,) = half_way(layout, assigned)
        os.kill(pid, signal.SIGSTOP)
        go(layout)
        watcher = Record()
        assert pool(layout, assigned, watcher, lease_s=1.0).run() is Exit.DONE
        files = layout.run(assigned[0].id)
        before = {path: path.stat().st_mtime_ns for path in files.path.rglob("*") if path != files.log}
        os.kill(pid, signal.SIGCONT)
        assert one.wait() == 0
    assert any("no sign of life" in note for note in watcher.notes)
    assert before == {path: path.stat().st_mtime_ns for path in files.path.rglob("*") if path != files.log}
    assert "belongs to another process" in "\n".join(log_tail(files))
    assert rows(tmp_path) == expected(range(1))
    assert attempts(layout, assigned) == [2]


@pytest.mark.slow
def test_a_worker_that_takes_too_much_memory_is_ended_and_goes_on(tmp_path: Path, behave: Callable[..., None]) -> None:
    """It is tried again from its checkpoint, and the reason names what it took and what it may."""
    behave(other="leak")
    layout, assigned = prepare(tmp_path, range(1))
    watcher = Record()
    assert pool(layout, assigned, watcher, memory_limit=256 * 2**20).run() is Exit.DONE
    (error,) = watcher.errors
    assert re.fullmatch(r"Memory: took 0\.\d\d GiB of memory, 0\.25 GiB are allowed, and was ended", error)
    assert watcher.notes == ["from step 0", "from step 20"]
    assert rows(tmp_path) == expected(range(1))
