"""Who runs what `run` and `resume` have planned: processes here, job arrays, or a Ray cluster."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, NamedTuple, TypedDict

from rrm.hardware import usable_cores
from rrmctl.cli.options import HANG_AFTER_MIN
from rrmctl.cli.progress import experiments, runs
from rrmctl.cli.screen import tell
from rrmctl.commands import rrmctl
from rrmctl.errors import Exit, UserError, check_known

if TYPE_CHECKING:
    from rich.console import Console

    from rrmctl.running.cards import Cards
    from rrmctl.running.executor import Executor
    from rrmctl.running.slurm import Submission
    from rrmctl.running.slurm_arrays import Array
    from rrmctl.running.supervisor import Terms
    from rrmctl.store.layout import Layout
    from rrmctl.store.sweeps import Job, SweepRecord


@dataclass(frozen=True, kw_only=True)
class Options:
    """How runs are to be run, as it was typed. Raises UserError where an option means nothing to the executor."""

    executor: str
    workers: int | None = None
    memory: float | None = None  #: GiB
    hang_after: float = HANG_AFTER_MIN  #: minutes
    label: bool = False
    slurm: Sequence[str] | None = None
    at_once: int | None = None
    pack: int | None = None
    address: str | None = None
    gpus: str | None = None
    per_gpu: int | None = None
    mps: bool = False

    def __post_init__(self) -> None:
        check_known(self.executor, EXECUTORS, f'there is no executor "{self.executor}"')
        for field in fields(self)[1:]:
            if getattr(self, field.name) != field.default and field.name not in EXECUTORS[self.executor].options:
                word = f"--{field.name.replace('_', '-')}"
                whose = ", ".join(name for name, other in EXECUTORS.items() if field.name in other.options)
                raise UserError(f"{word} means nothing with --executor {self.executor}", f"it is for {whose}")
        if self.gpus is not None:
            (_numbers if self.local else _share)(self.gpus)

    @property
    def local(self) -> bool:
        """The runs are run on this machine."""
        return EXECUTORS[self.executor].here

    @property
    def again(self) -> list[str]:
        """Words that have `resume` run things in the same way; none for this machine."""
        if self.local:
            return []
        words = ["--executor", self.executor]
        for field in fields(self)[1:]:
            value = getattr(self, field.name)
            if value != field.default and field.name != "label":
                word = f"--{field.name.replace('_', '-')}"
                words += [f"{word}={each}" for each in (value if isinstance(value, list) else [value])]
        return words

    def slots(self, threads: Iterable[int], jobs: int, on_cards: int = 0) -> int:
        """How many runs there are at a time, at the best; so many of the jobs are on graphics cards."""
        if not self.local:
            return max(1, min(jobs, self.at_once or jobs))
        most = max(threads, default=1)
        cores, places = usable_cores() // most, self.cards(most).places if on_cards else 0
        slots = self.workers or max(1, cores, places)
        return min(slots, max(1, places)) if 0 < on_cards == jobs else slots

    def cards(self, threads: int) -> Cards:
        """The cards of this machine that runs of so many threads may use; none where there are none.

        Raises UserError where one that was named is not here.
        """
        from rrm import devices
        from rrmctl.planning import card_rates
        from rrmctl.running.cards import Cards, names

        here = devices.cards()
        numbers = list(range(len(here))) if self.gpus is None else _numbers(self.gpus)
        if gone := [number for number in numbers if number >= len(here)]:
            there = ", ".join(map(devices.in_words, here)) or "there is none"
            raise UserError(f"--gpus {self.gpus}: there is no card {gone[0]} here", f"cards here: {there}")
        called = names(len(here))
        share = max(1, usable_cores() // threads // max(1, len(numbers)))  # of the cores, for each card
        rooms: dict[str, int] = {}
        for number in numbers:
            rates = card_rates.read(here[number], mps=self.mps)
            usual = min(rates.best, rates.fitting(here[number].memory), share) if rates else 1
            rooms[called[number]] = self.per_gpu or max(1, usual)
        return Cards(rooms)


def _numbers(gpus: str) -> list[int]:
    """Numbers of cards, as typed."""
    words = [word.strip() for word in gpus.split(",")]
    if not all(word.isascii() and word.isdecimal() for word in words):
        meant = "with --executor local it lists cards by CUDA's numbers, e.g. 0,1; --per-gpu N has N runs share each"
        raise UserError(f"--gpus is {gpus}, not a list of cards", meant)
    return list(dict.fromkeys(map(int, words)))


def _share(gpus: str) -> float:
    """A share of a card, as typed."""
    try:
        return float(gpus)
    except ValueError:
        hint = "with --executor ray it is a number, e.g. 0.25: Ray chooses the cards"
        raise UserError(f"--gpus is {gpus}, not a share of a card", hint) from None


class Work(NamedTuple):
    """Runs of some sweeps, and how each is to be run."""

    console: Console
    layout: Layout
    assigned: Mapping[Job, Terms]
    sweeps: Sequence[SweepRecord]


def train(work: Work, options: Options) -> Exit:
    """Have the executor run what there is to run."""
    return EXECUTORS[options.executor].run(work, options) if work.assigned else Exit.DONE


def _here(work: Work, options: Options) -> Exit:
    from rrmctl.running.config_file import on_card
    from rrmctl.running.local import LocalExecutor

    threads = [terms.threads for terms in work.assigned.values()]
    on_cards = {job.id for job in work.assigned if on_card(work.layout.run(job.id))}
    slots = options.slots(threads, len(work.assigned), len(on_cards))
    if not on_cards:
        if (options.gpus, options.per_gpu, options.mps) != (None, None, False):
            tell("note: none of these runs is on a card: --gpus, --per-gpu and --mps change nothing", err=True)
        return _drive(work, LocalExecutor(layout=work.layout, **_limits(options)), slots)
    cards = options.cards(max(threads))
    with _served(cards) if options.mps else contextlib.nullcontext(cards) as cards:
        executor = LocalExecutor(layout=work.layout, cards=cards, **_limits(options))
        return _drive(work, executor, slots, on_cards, cards.places)


@contextlib.contextmanager
def _served(cards: Cards) -> Iterator[Cards]:
    """The same cards, by way of an MPS daemon."""
    from rrmctl.running.cards import Cards
    from rrmctl.running.mps import client_names, service

    called = list(cards.rooms)
    with service(called) as variables:
        yield Cards(dict(zip(client_names(called), cards.rooms.values(), strict=True)), variables)


def _ray(work: Work, options: Options) -> Exit:
    from rrmctl.cli.user_config import ray_site

    gpus = None if options.gpus is None else _share(options.gpus)
    site = ray_site(options.address, gpus, options.at_once)
    try:
        from rrmctl.running.ray_executor import RayExecutor, connected, misfits
    except ModuleNotFoundError as error:
        if error.name != "ray":
            raise
        hint = "pip install 'rrmctl[ray]', on every node of the cluster"
        raise UserError("this needs Ray, which is not installed", hint) from None
    executor = RayExecutor(layout=work.layout, gpus=site.gpus, **_limits(options))
    with connected(site.address):
        for what in misfits(executor.needs(job.id, terms.threads) for job, terms in work.assigned.items()):
            tell(f"note: no node of the cluster has {what} now; runs that need that wait for one", err=True)
        return _drive(work, executor, min(site.at_once or len(work.assigned), len(work.assigned)))


class _Limits(TypedDict):
    memory_limit: int | None
    hang_after_s: float


def _limits(options: Options) -> _Limits:
    memory = None if options.memory is None else int(options.memory * 2**30)
    return {"memory_limit": memory, "hang_after_s": options.hang_after * 60.0}


def _drive(work: Work, executor: Executor, slots: int, on_cards: Collection[str] = (), places: int = 0) -> Exit:
    """See the runs to their end, shown as bars at a terminal and as lines elsewhere.

    Those `on_cards` wait for one of so many places.
    """
    from rrmctl.cli.live import Bars, Lines
    from rrmctl.running.supervisor import Supervisor
    from rrmctl.store.sweeps import deployments_first

    console, layout, assigned, sweeps = work
    watched = sys.stderr.isatty() and not console.is_dumb_terminal
    watcher = (Bars if watched else Lines)(console, layout, list(assigned), experiments(sweeps))
    with watcher.progress if isinstance(watcher, Bars) else contextlib.nullcontext():
        return Supervisor(
            layout=layout, jobs=deployments_first(assigned, sweeps), slots=slots,
            terms={job.id: terms for job, terms in assigned.items()}, watcher=watcher, executor=executor,
            on_cards=on_cards, places=places, asked=["rrmctl", *sys.argv[1:]],
        ).run()  # fmt: skip


def _slurm(work: Work, options: Options) -> Exit:
    """Submit what is neither queued nor running, and say what was submitted."""
    from rrmctl.cli.user_config import slurm_site
    from rrmctl.running.config_file import on_card
    from rrmctl.running.slurm import lost, read_queue, submissions
    from rrmctl.running.slurm_arrays import Order, submit
    from rrmctl.store.files import locked
    from rrmctl.store.labels import waits_for
    from rrmctl.store.status import statuses

    console, layout, assigned, sweeps = work
    site = slurm_site(options.slurm or (), options.at_once, options.pack)
    names, asked = experiments(sweeps), ["rrmctl", *sys.argv[1:]]

    def told(submission: Submission, array: Array) -> None:
        count = sum(map(len, submission.tasks))
        tasks = f"{len(submission.tasks)} task{'s' if len(submission.tasks) != 1 else ''}"
        tell(f"{array.experiment}: {runs(count)} submitted as job {submission.job}, {tasks}")

    with locked(layout.slurm_lock):
        submitted = submissions(layout)
        queue = read_queue(submitted, names)
        states = statuses(layout, assigned)
        elsewhere = {job.id for job in assigned if states[job.id].state == "running"} - queue.keys()
        elsewhere -= lost(layout, elsewhere)
        asking = {job.id for job in assigned if waits_for(layout.run(job.id), states[job.id]) is not None}
        left = [job for job in assigned if job.id not in queue.keys() | elsewhere | asking]
        queued = {job.id: job.requires for job in assigned if job not in left}
        orders = [Order(job, assigned[job], names[job.id], on_card(layout.run(job.id))) for job in left]
        submit(layout, orders, site, queue=queue, queued=queued, asked=asked, told=told)
    for count, what in ((len(queue.keys() & {job.id for job in assigned}), "queued or running there already"),
                        (len(elsewhere), "run by other processes"), (len(asking), "waiting for people")):  # fmt: skip
        if count:
            console.print(f"{runs(count)} {what}", soft_wrap=True)
    only = {sweep.experiment for sweep in sweeps}
    tell(f"Watch: {rrmctl('status', *(only if len(only) == 1 else ()), results=layout.root)}")
    return Exit.INCOMPLETE


class _Executor(NamedTuple):
    run: Callable[[Work, Options], Exit]
    options: tuple[str, ...]  #: those that mean something to it
    here: bool  #: on this machine


#: What --executor takes.
EXECUTORS = {
    "local": _Executor(_here, ("workers", "memory", "hang_after", "label", "gpus", "per_gpu", "mps"), here=True),
    "slurm": _Executor(_slurm, ("slurm", "at_once", "pack"), here=False),
    "ray": _Executor(_ray, ("address", "gpus", "at_once", "memory", "hang_after", "label"), here=False),
}
