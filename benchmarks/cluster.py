"""What a cluster's engine costs a job, and what we add to it: a thousand one-second jobs by Slurm and by Ray.

Ours are runs that train nothing (`benchmarks.second`), the peers' are `sleep 1`. The cost is the time of one of the
slots that a job took, less its second. Slots, engines and jobs share this machine, and each of ours begins with a
Python or two, so that on few cores the processor is the limit, not the engine. Needs Slurm (`make cluster`) and the
extra `ray`; with JOBS=100 in the environment it is shorter.
"""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from rich.console import Console

from benchmarks import second
from benchmarks.lines import Line
from rrmctl.cli.live import Lines
from rrmctl.running.slurm_arrays import Order, Site, submit
from rrmctl.running.supervisor import Supervisor, Terms
from rrmctl.store.status import statuses
from tests.cluster import ray as rays
from tests.cluster import slurm
from tests.rrmctl.running.standin import prepare

_JOBS = int(os.environ.get("JOBS", "1000"))
_SLOTS = 6
_PACK = 10
_SMALL = "--mem=100"  #: else a job takes all memory of its node


def lines() -> Iterator[Line]:
    """Seconds of a slot per job, beyond the job's own."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as name:
        root = Path(name)
        with rays.ray(cores=_SLOTS // len(rays.NODES)) as cluster:
            os.environ |= cluster.environment
            from rrmctl.running.ray_executor import connected  # Ray reads the environment when it is imported

            with connected(cluster.address):
                yield _line("Ray", lambda: _by_ray(root / "ray"), **{"ray.remote": _bare_ray})
        if (reason := slurm.missing()) is not None:
            print(reason, file=sys.stderr)
            return
        with slurm.slurm(root / "slurm", largest=_JOBS + 1, cores=_SLOTS // len(slurm.NODES)) as controller:
            os.environ |= controller.environment
            yield _line("Slurm", lambda: _by_slurm(controller, root / "single", 1), srun=_bare_slurm)
            yield _line(f"Slurm, {_PACK} runs a task", lambda: _by_slurm(controller, root / "packed", _PACK))


def _line(engine: str, ours: Callable[[], object], **peers: Callable[[], object]) -> Line:
    walls = {name: _seconds(work) for name, work in {**peers, "ours": ours}.items()}
    costs = {name: wall * _SLOTS / _JOBS - 1.0 for name, wall in walls.items()}
    note = (
        f"{_JOBS} jobs of 1 s, {_SLOTS} at a time: {', '.join(f'{name} {wall:.0f} s' for name, wall in walls.items())}"
    )
    return Line(item=f"{engine}: cost of a job", ours=costs.pop("ours"), unit="s", peers=costs, note=note)


def _seconds(work: Callable[[], object]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def _bare_ray() -> None:
    import ray

    sleep = ray.remote(num_cpus=1)(lambda: time.sleep(1.0))
    ray.get([sleep.remote() for _ in range(_JOBS)])


def _by_ray(root: Path) -> None:
    from rrmctl.running.ray_executor import RayExecutor

    layout, jobs = prepare(root, range(_JOBS))
    with Path(os.devnull).open("w") as nothing:
        watcher = Lines(Console(file=nothing), layout, jobs)
        executor = RayExecutor(layout=layout, command=(*second.COMMAND, "worker"))
        supervisor = Supervisor(layout=layout, jobs=jobs, slots=len(jobs), watcher=watcher, executor=executor)
        assert supervisor.run() == 0


def _bare_slurm() -> None:
    one = ["xargs", f"-P{_SLOTS}", "-n1", "srun", "--quiet", "--ntasks=1", _SMALL, "sleep"]
    subprocess.run(one, input="1\n" * _JOBS, text=True, check=True)


def _by_slurm(controller: slurm.Slurm, root: Path, pack: int) -> None:
    layout, jobs = prepare(root, range(_JOBS))
    ours = f'exec {shlex.join([*second.COMMAND, "task", str(root)])} "$SLURM_JOB_NAME"'
    orders = [Order(job, Terms(), "stand-in") for job in jobs]
    submit(
        layout,
        orders,
        Site(flags=(_SMALL,), setup=ours, pack=pack),
        queue={},
        queued={},
        asked=(),
        told=lambda _submission, _array: None,
    )
    slurm.until(lambda: not controller.queue(), patience_s=_JOBS * 10.0)
    assert {status.state for status in statuses(layout, jobs).values()} == {"done"}
