"""Job arrays as they are planned, written and read back; tests/cluster has them run."""

from __future__ import annotations

import dataclasses
import signal
import subprocess
from pathlib import Path

import pytest

from rrmctl.running.slurm import (
    RefusedError,
    SlurmError,
    Submission,
    Task,
    ask,
    lost,
    parse_queue,
    read_submission,
    write_submission,
)
from rrmctl.running.slurm_arrays import Order, Site, arrays, largest_array, levels, sbatch, script
from rrmctl.running.slurm_task import goes_on
from rrmctl.running.supervisor import Terms
from rrmctl.store.layout import Layout
from rrmctl.store.owner import Beat, Machine
from rrmctl.store.sweeps import Job

A, B, C, D = (letter * 16 for letter in "abcd")


def order(run: str, *requires: str, threads: int = 1, experiment: str = "toy-car", gpu: bool = False) -> Order:
    job = Job(
        id=run, cell=run, task="t", method="m", teacher="", feedback="", seed=0, steps=1, requires=requires
    )  # fmt: skip
    return Order(job, Terms(threads=threads), experiment, gpu)


def runs(planned: object) -> list[list[list[str]]]:
    return [[[each.job.id for each in task] for task in array.tasks] for array in planned]  # type: ignore[attr-defined]


def test_levels_follow_what_runs_need() -> None:
    """The longest way down counts; what is not named is done already."""
    assert levels({"d": ("c", "a"), "c": ("b",), "b": ("a", "elsewhere"), "a": ()}) == {"d": 3, "c": 2, "b": 1, "a": 0}


def test_arrays_are_of_one_level_and_kind() -> None:
    """Needed runs first, whatever the order in which they were named; other threads or a card are another array."""
    orders = [order(B, A), order(A), order(C, threads=2), order(D, gpu=True)]
    assert runs(arrays(orders, {}, 1, 99)) == [[[A]], [[D]], [[C]], [[B]]]
    assert [array.gpu for array in arrays(orders, {}, 1, 99)] == [False, True, False, False]
    assert runs(arrays([order(B, A), order(C)], {A: ()}, 1, 99)) == [[[C]], [[B]]]


def test_arrays_are_packed_and_cut() -> None:
    """`pack` runs a task, and no more tasks than the site allows, each array's from 0 on."""
    orders = [order(letter * 16) for letter in "0123456789"]
    packed = arrays(orders, {}, 3, 2)
    assert [[len(task) for task in array.tasks] for array in packed] == [[3, 3], [3, 1]]
    assert [each.job.id[0] for array in packed for each in array.runs] == [*"0123456789"]


@pytest.mark.parametrize(
    ("config", "largest"), [("X = 2\nMaxArraySize            = 1001\nY = 3", 1001), ("MaxArraySize = 0", 1), ("", 1)]
)
def test_the_site_says_how_large_an_array_may_be(config: str, largest: int) -> None:
    """As `scontrol show config` prints it."""
    assert largest_array(config) == largest


def test_the_command_and_its_script(tmp_path: Path) -> None:
    """The user's flags stand as typed, after ours that they may change and before those that they may not."""
    (array,) = arrays([order(A, threads=2, gpu=True), order(B, threads=2, gpu=True)], {}, 1, 99)
    site = Site(("--account=x y", "--gres=none"), "module load cuda\nset -e", at_once=7)
    command = sbatch("toy-car-1", array, site, Path("/r 100%/slurm"), ["12", "15"])
    assert command[:6] == [
        "sbatch", "--requeue", "--open-mode=append", "--signal=B:USR1@300", "--cpus-per-task=2", "--gres=gpu:1"
    ]  # fmt: skip
    assert command[6:8] == ["--account=x y", "--gres=none"]
    assert command[8:] == [
        "--parsable", "--job-name=toy-car-1", "--array=0-1%7", "--output=/r 100%%/slurm/%A_%a.log",
        "--dependency=afterany:12:15",
    ]  # fmt: skip
    text = script(command, site.setup, ["/a b/python", "-P"])
    assert text.splitlines()[2:] == ["module load cuda", "set -e", "exec '/a b/python' -P"]
    assert text.startswith("#!/bin/bash\n# sbatch --requeue")
    assert "'--account=x y'" in text
    subprocess.run(["bash", "-n"], input=text, text=True, check=True)


def test_a_submission_is_read_as_it_was_written(tmp_path: Path) -> None:
    """Before Slurm has given it a number, and after; other files in the folder are none."""
    layout = Layout(tmp_path)
    written = Submission(name="x-1", tasks=({A: Terms(attempt=2, fresh=True), B: Terms()},), asked=("rrmctl", "run"))
    for submission in (written, dataclasses.replace(written, job="12")):
        write_submission(layout, submission)
        assert read_submission(layout, "x-1") == submission
    (layout.slurm / "12_0.log").touch()
    (layout.slurm / "x-1.sh").touch()
    assert layout.submissions() == ["x-1"]


def test_squeue_is_read() -> None:
    """One line a task; a packed task is that of all its runs, and jobs of others are left out."""
    submitted = {"x-1": Submission(name="x-1", tasks=({A: Terms()}, {B: Terms(), C: Terms()}), asked=())}
    printed = "other|7|0|RUNNING|None|n9\nx-1|12|0|RUNNING|None|n1\nx-1|12|1|PENDING|Dependency|\nodd line\n"
    queue = parse_queue(printed, submitted)
    assert queue == {
        A: Task("12", 0, "RUNNING", "None", "n1"),
        B: Task("12", 1, "PENDING", "Dependency", ""),
        C: Task("12", 1, "PENDING", "Dependency", ""),
    }
    assert [queue[run].id for run in (A, C)] == ["12_0", "12_1"]
    assert [queue[run].pending for run in (A, C)] == [False, True]


@pytest.mark.parametrize(
    ("signals", "state", "expected"),
    [
        ([signal.SIGUSR1], "RUNNING", True),  # its time is nearly over
        ([signal.SIGTERM, signal.SIGTERM], "SIGNALING", True),  # preempted
        ([signal.SIGTERM], "COMPLETING", False),  # scancel
        ([signal.SIGUSR1, signal.SIGTERM], "COMPLETING", False),  # the same, while it leaves
        ([signal.SIGTERM, signal.SIGINT], "RUNNING", False),  # rrmctl stop
        ([signal.SIGTERM], None, False),
    ],
)
def test_who_is_queued_again(signals: list[int], state: str | None, expected: bool) -> None:
    """What Slurm wants gone goes on later, what its user wants gone does not."""
    shown = f"JobId=5 ArrayJobId=4\n   JobState={state} Reason=None Dependency=(null)\n" if state else ""
    assert goes_on(signals, shown) is expected


def test_programs_that_are_not_here_or_refuse(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One line with their words; one that was killed may have been heard, and is no refusal."""
    with pytest.raises(RefusedError, match="there is no no-such-program on this machine"):
        ask("no-such-program")
    with pytest.raises(RefusedError, match=r"^sh refused: no such account$"):
        ask("sh", "-c", "echo no such >&2; echo account >&2; exit 1")
    with pytest.raises(SlurmError) as caught:
        ask("sh", "-c", "kill -9 $$")
    assert not isinstance(caught.value, RefusedError)


def test_what_is_over_is_no_refusal() -> None:
    """A task may end before scancel comes to it; what else it says beside that counts."""
    over = "echo 'scancel: error: Kill job error on job id 26_0: Invalid job id specified' >&2"
    assert ask("sh", "-c", f"{over}; exit 1", but=["Invalid job id"]) == ""
    with pytest.raises(SlurmError, match=r"sh refused: not yours$"):
        ask("sh", "-c", f"{over}; echo not yours >&2; exit 1", but=["Invalid job id"])
    with pytest.raises(SlurmError, match="left with 3"):
        ask("sh", "-c", "exit 3", but=["Invalid job id"])


def test_a_run_of_another_machine_that_is_silent_is_lost(tmp_path: Path) -> None:
    """Its last sign of life stands still; one that says something is not, nor one that holds its lock."""
    folder = Layout(tmp_path).run(A)
    folder.path.mkdir(parents=True)
    folder.lease_of(1).write_bytes(Beat("o", 1, Machine("elsewhere", "boot")).encoded())
    assert lost(Layout(tmp_path), [A], silence_s=0.1) == {A}
