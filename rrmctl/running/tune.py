"""How many runs at a time a graphics card bears: found by having more and more of them train on it."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from rrm.devices import CPU, CUDA
from rrm.environ import run_python
from rrmctl.errors import UserError
from rrmctl.planning.card_rates import PAYS, Rates
from rrmctl.planning.cost import trial
from rrmctl.running.cards import VISIBLE, Cards
from rrmctl.running.config_file import config_content
from rrmctl.running.executor import Ended, Progress, WorkOrder
from rrmctl.running.local import LocalExecutor
from rrmctl.store.layout import Layout
from rrmctl.store.provenance import record_config
from rrmctl.store.status import ErrorKind

#: Prints how many bytes of the card are in use, those of this process included.
_USED = "import torch; free, total = torch.cuda.mem_get_info(); print(total - free)"

_TICK_S = 0.2


@dataclass(frozen=True, kw_only=True)
class Place:
    """What is measured, and for how long."""

    device: str = CUDA  #: "cpu" rehearses it
    card: str = "0"  #: its name in `CUDA_VISIBLE_DEVICES`
    memory: int  #: bytes, of the card
    cores: int  #: of the machine: a run keeps one busy
    variables: Mapping[str, str] = field(default_factory=dict)  #: by which processes find the daemon of MPS
    warm_up: int = 600  #: steps of every run before it counts
    seconds: float = 8.0  #: that are measured, of every number of runs


class _FullError(Exception):
    """So many runs do not fit into the card's memory."""


def measure(place: Place, told: Callable[[int, float], None]) -> Rates:
    """What 1, 2, 4, ... runs make together, until twice as many bring no tenth more, or find no memory or cores.

    `told` takes each number, and environment steps a second of all together. Raises UserError where a run fails.
    """
    rates: dict[int, float] = {}
    run_bytes, count = 1, 1
    before = _used(place)
    while True:
        try:
            rates[count], used = _together(place, count)
        except _FullError as error:
            if not rates:
                raise UserError(f"not one run of the trial fits: {error}") from error
            break
        told(count, rates[count])
        run_bytes = max(run_bytes, (used - before) // count)
        found = Rates(rates, run_bytes)
        pays = count == 1 or rates[count] >= PAYS * rates[count // 2]
        count *= 2
        if not pays or count > place.cores or count > found.fitting(place.memory):
            break
    return Rates(rates, run_bytes)


def _together(place: Place, count: int) -> tuple[float, int]:
    """Steps a second of so many runs together, and the memory that is in use then."""
    cards = None if place.device == CPU else Cards({place.card: count}, place.variables)
    with tempfile.TemporaryDirectory(prefix="rrmctl-tune-") as folder:
        layout = Layout(Path(folder))
        executor = LocalExecutor(layout=layout, cards=cards)
        steps: dict[str, int] = {}
        try:
            for seed in range(count):
                config = trial(place.device, seed)
                steps[config.identity] = 0
                record_config(layout.run(config.identity), config_content(config))
                executor.submit(WorkOrder(run=config.identity, threads=config.threads))
            while min(steps.values()) < place.warm_up:
                _heed(executor, steps)
            begin, already = time.monotonic(), sum(steps.values())
            while (took := time.monotonic() - begin) < place.seconds:
                _heed(executor, steps)
            rate = (sum(steps.values()) - already) / took
            return rate, executor.memory() if place.device == CPU else _used(place)
        finally:
            executor.close()


def _heed(executor: LocalExecutor, steps: dict[str, int]) -> None:
    """Take in how far the runs are; none of them ends by itself."""
    for event in executor.events(_TICK_S):
        match event:
            case Progress(run, step):
                steps[run] = step
            case Ended(_, outcome) if outcome.error is not None and outcome.error.kind is ErrorKind.MEMORY:
                raise _FullError(outcome.error.message)
            case Ended(_, outcome):
                raise UserError(f"a run of the trial ended: {outcome.error or outcome.ending}")


def _used(place: Place) -> int:
    """Bytes of the card that are in use; by a process of its own, since looking takes some, the same each time."""
    if place.device == CPU:
        return 0
    try:
        return int(run_python(_USED, **{VISIBLE: place.card, **place.variables}))
    except RuntimeError as error:
        raise UserError(f"the card {place.card} cannot be used: {error}") from error
