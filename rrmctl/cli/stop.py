"""`rrmctl stop`: ends a sweep in good order, whoever runs it."""

from __future__ import annotations

import contextlib
import os
import signal
import time
from typing import Annotated

import typer

from rrmctl.cli.options import DEFAULT_RESULTS, ResultsOption
from rrmctl.cli.progress import runs
from rrmctl.cli.screen import tell
from rrmctl.commands import rrmctl
from rrmctl.errors import Exit, UserError

#: How long the end is waited for, seconds, and how often it is looked for.
_WAIT_S = 60.0
_LOOK_S = 1.0


def stop(
    name: Annotated[str, typer.Argument(metavar="NAME", help="The experiment whose runs are to stop.")],
    results: ResultsOption = DEFAULT_RESULTS,
) -> None:
    """End a sweep in good order: what is queued leaves the queue, what runs writes a checkpoint and leaves.

    Of an `rrmctl` on this machine everything stops that it runs, as after Ctrl-C. Leaves with 75 where something still
    runs after a minute.
    """
    from rrmctl.running.slurm import cancel, interrupt, read_queue, submissions
    from rrmctl.store.drivers import drivers
    from rrmctl.store.snapshot import Snapshot
    from rrmctl.store.status import statuses

    store = Snapshot(results, name)
    jobs = [job for sweep in store.sweeps for job in sweep.everything]
    submitted = submissions(store.layout)
    told, stopped = set[int](), False  # processes, and whether anything was there to stop
    again: tuple[str, ...] = ("--executor", "slurm")
    deadline = time.monotonic() + _WAIT_S
    while True:
        known = drivers(store.layout, name)
        here = [driver for driver in known if driver.here]
        for driver in here:
            if driver.pid not in told:
                with contextlib.suppress(ProcessLookupError):
                    _tell_to_leave(driver.pid)
        queue = read_queue(submitted, store.states)
        cancel([task for task in queue.values() if task.pending])
        interrupt([task for task in queue.values() if task.state == "RUNNING"])
        told |= {driver.pid for driver in here}
        again, stopped = here[0].again if here else again, stopped or bool(here or queue)
        if not (queue or here) or time.monotonic() > deadline:
            break
        time.sleep(_LOOK_S)
    states = statuses(store.layout, jobs)
    running = {str(states[run].host) for run in states if states[run].state == "running" and run not in queue}
    elsewhere = {driver.host for driver in known if not driver.here}
    if queue or here:
        left = runs(len(queue)) if queue else f"{len(here)} rrmctl"
        tell(f"{left} asked to stop and not gone yet; the same command looks again")
    elif elsewhere or running:
        for host in sorted(elsewhere or running):
            tell(f"Still running on {host}: stop the rrmctl that runs it there")
    elif stopped:
        tell(f"Stopped; this goes on: {rrmctl('resume', name, *again, results=store.layout.root)}")
    else:
        tell(f"Nothing of {name} is queued or running.")
    raise typer.Exit(Exit.INCOMPLETE if queue or here or elsewhere or running else Exit.DONE)


def _tell_to_leave(pid: int) -> None:
    try:
        os.kill(pid, signal.SIGTERM)
    except PermissionError:
        raise UserError(f"process {pid} runs it and is another user's", "ask them to stop it") from None
