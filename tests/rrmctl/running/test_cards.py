"""Runs share graphics cards: who gets which, and what their processes are told; no card is needed for that."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import pytest

from rrmctl.errors import Exit, UserError
from rrmctl.planning.card_rates import Rates
from rrmctl.running.cards import Cards, names
from rrmctl.running.executor import WorkOrder
from rrmctl.running.local import LocalExecutor
from rrmctl.running.mps import client_names, service
from rrmctl.running.scheduler import Stage
from rrmctl.running.supervisor import Supervisor
from rrmctl.running.tune import Place, measure
from rrmctl.store.files import StorageError
from rrmctl.store.layout import Layout
from rrmctl.store.status import ErrorKind, RunState, read_status
from rrmctl.store.sweeps import Job
from tests.rrmctl.running.standin import COMMAND, prepare
from tests.rrmctl.running.test_supervisor import Record, half_way, states

VISIBLE, CUBLAS, PIPE = "CUDA_VISIBLE_DEVICES", "CUBLAS_WORKSPACE_CONFIG", "CUDA_MPS_PIPE_DIRECTORY"


def taken(cards: Cards, run: str) -> str:
    return cards.take(run)[VISIBLE]


def test_the_card_with_the_fewest_runs_comes_first() -> None:
    """Of equal ones the first; a place that is given back is taken again; a card is never fuller than it may be."""
    cards = Cards({"0": 2, "1": 2})
    assert [taken(cards, run) for run in "abc"] == ["0", "1", "0"]
    cards.free("a")
    cards.free("c")
    cards.free("nobody")
    assert [taken(cards, run) for run in "def"] == ["0", "0", "1"]
    assert cards.places == 4
    assert [taken(Cards({"0": 1, "1": 3}), run) for run in "a"] == ["0"]


def test_cards_that_the_user_has_chosen() -> None:
    """Numbers are those of CUDA's list here, which is what CUDA_VISIBLE_DEVICES names where it is set."""
    assert names(3, {}) == ["0", "1", "2"]
    assert names(2, {VISIBLE: "3, 1"}) == ["3", "1"]
    assert names(1, {VISIBLE: "GPU-2dcd,7"}) == ["GPU-2dcd"]
    assert names(0, {VISIBLE: ""}) == []
    assert client_names(["3", "GPU-2dcd", "1"]) == ["0", "GPU-2dcd", "2"]


@pytest.fixture
def telling(monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs note what they are told of cards; this process is told of some itself."""
    monkeypatch.setenv("STANDIN_TELL", f"{VISIBLE} {CUBLAS} {PIPE}")
    monkeypatch.setenv(VISIBLE, "5,6")


class Told(Record):
    """Also by run."""

    def __init__(self) -> None:
        super().__init__()
        self.of: dict[str, dict[str, str]] = {}

    def note(self, job: str, text: str) -> None:
        name, equals, value = text.partition("=")
        if equals:
            self.of.setdefault(job, {})[name] = value


def pool(layout: Layout, assigned: list[Job], on_cards: range, cards: Cards | None, **options: object) -> Supervisor:
    settings: dict[str, object] = {
        "slots": 4, "executor": LocalExecutor(layout=layout, cards=cards, command=COMMAND),
        "on_cards": {job.id for job in assigned if job.seed in on_cards}, "places": cards.places if cards else 4,
    }  # fmt: skip
    return Supervisor(layout=layout, jobs=assigned, **(settings | options))


@pytest.mark.slow
@pytest.mark.usefixtures("telling")
def test_each_process_finds_one_card(tmp_path: Path) -> None:
    """Of five runs on two cards of one place each; a sixth on the processor finds none, in the same sweep."""
    layout, assigned = prepare(tmp_path, range(6), on_cards=range(5))
    told = Told()
    cards = Cards({"5": 1, "6": 1})
    assert pool(layout, assigned, range(5), cards, watcher=told).run() is Exit.DONE
    found = [told.of[job.id][VISIBLE] for job in assigned]
    assert set(found[:5]) == {"5", "6"}
    assert found[5] == ""
    assert [told.of[job.id][CUBLAS] for job in assigned] == [":4096:8"] * 5 + ["None"]
    assert cards._on == {}


@pytest.mark.slow
@pytest.mark.usefixtures("telling")
def test_places_are_not_given_twice(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Five runs for two cards of two places: four at a time, two on each; the fifth when one has ended."""
    monkeypatch.setenv("STANDIN", '{"other": "gate"}')
    layout, assigned = prepare(tmp_path, range(5), on_cards=range(5))
    cards = Cards({"5": 2, "6": 2})
    loads = []

    class Watch(Told):
        def tick(self) -> None:
            loads.append(Counter(cards._on.values()))
            if sum((layout.run(job.id).path / "misbehaved").exists() for job in assigned) == 4:
                (tmp_path / "go").touch()

    assert pool(layout, assigned, range(5), cards, watcher=Watch(), slots=5).run() is Exit.DONE
    assert max(max(load.values(), default=0) for load in loads) == 2
    assert Counter({"5": 2, "6": 2}) in loads


@pytest.mark.slow
@pytest.mark.usefixtures("telling")
def test_without_cards_of_its_own_the_pool_leaves_the_choice(tmp_path: Path) -> None:
    """A batch system or a cluster has made it; runs on the processor are kept off all the same."""
    layout, assigned = prepare(tmp_path, range(2), on_cards=range(1))
    told = Told()
    assert pool(layout, assigned, range(1), None, watcher=told).run() is Exit.DONE
    assert [told.of[job.id][VISIBLE] for job in assigned] == ["5,6", ""]
    assert told.of[assigned[0].id][CUBLAS] == ":4096:8"


def test_a_run_that_cannot_be_started_takes_no_place(tmp_path: Path) -> None:
    """It is given back where the log cannot be opened."""
    layout, (job,) = prepare(tmp_path, range(1), on_cards=range(1))
    layout.run(job.id).log.mkdir()
    executor = LocalExecutor(layout=layout, cards=Cards({"0": 1}), command=COMMAND)
    for _ in range(2):
        with pytest.raises(StorageError):
            executor.submit(WorkOrder(run=job.id, threads=1))


@pytest.mark.slow
def test_a_full_card_costs_nobody_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The run that found no memory is tried again and fails with the remedy; the others go on."""
    monkeypatch.setenv("STANDIN", '{"0": "card-full"}')
    layout, assigned = prepare(tmp_path, range(3), on_cards=range(3))
    watcher = Record()
    assert pool(layout, assigned, range(3), Cards({"0": 3}), watcher=watcher).run() is Exit.FAILED
    assert states(layout, assigned) == [RunState.FAILED, RunState.DONE, RunState.DONE]
    error = read_status(layout.run(assigned[0].id)).error
    assert error is not None
    assert error.kind is ErrorKind.MEMORY
    assert "Tried to allocate 2.00 GiB): fewer runs to a card (--per-gpu)" in error.message
    assert watcher.starts[assigned[0].id] > 2
    assert watcher.phases[assigned[1].id] is Stage.DONE


#: Keeps a list of how it is called, what it is told and which cards it sees.
DAEMON = """#!/bin/sh
echo "$* / $(cat) / $CUDA_VISIBLE_DEVICES / $CUDA_MPS_PIPE_DIRECTORY $CUDA_MPS_LOG_DIRECTORY" >> "$MPS_CALLS"
"""

#: Runs the sweep of a folder under the service.
PARENT = """
import sys
from pathlib import Path
from tests.rrmctl.running.standin import COMMAND, prepare
from tests.rrmctl.running.test_supervisor import Record
from rrmctl.running.cards import Cards
from rrmctl.running.local import LocalExecutor
from rrmctl.running.mps import service
from rrmctl.running.supervisor import Supervisor
layout, assigned = prepare(Path(sys.argv[1]), range(2), on_cards=range(2))
with service(["5", "6"]) as variables:
    code = Supervisor(
        layout=layout, jobs=assigned, slots=2, watcher=Record(), on_cards=[job.id for job in assigned], places=2,
        executor=LocalExecutor(layout=layout, cards=Cards({"0": 2}, variables), command=COMMAND),
    ).run()
sys.exit(code)
"""


@pytest.fixture
def daemon(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A stand-in for NVIDIA's on the path; the file of its calls."""
    program = tmp_path / "bin" / "nvidia-cuda-mps-control"
    program.parent.mkdir()
    program.write_text(DAEMON)
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{program.parent}:{os.environ['PATH']}")
    monkeypatch.setenv("MPS_CALLS", str(tmp_path / "calls"))
    return tmp_path / "calls"


def test_the_service_is_started_and_asked_to_quit(daemon: Path) -> None:
    """With folders of our own, which are gone afterwards, and the cards that it is for; also where something fails."""
    with contextlib.suppress(KeyboardInterrupt), service(["5", "6"]) as variables:
        assert all(Path(folder).is_dir() for folder in variables.values())
        raise KeyboardInterrupt
    folders = f"{variables[PIPE]} {variables['CUDA_MPS_LOG_DIRECTORY']}"
    started, left = daemon.read_text().splitlines()
    assert started == f"-d /  / 5,6 / {folders}"
    assert re.fullmatch(rf" / quit / .* / {folders}", left)
    assert not Path(variables[PIPE]).parent.exists()


def test_where_there_is_no_service(daemon: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One line; the same where the daemon does not start, with its last words."""
    program = tmp_path / "bin" / "nvidia-cuda-mps-control"
    program.write_text("#!/bin/sh\necho An instance of this daemon is already running\nexit 1\n")
    with pytest.raises(UserError, match=r"fails: An instance of this daemon is already running$"), service(["0"]):
        pass
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(UserError, match="--mps needs nvidia-cuda-mps-control, which is not on"), service(["0"]):
        pass


@pytest.mark.slow
@pytest.mark.parametrize("signals", [0, 1, 2])
def test_the_service_ends_with_the_sweep(
    daemon: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, signals: int
) -> None:
    """Done, stopped by Ctrl-C, or ended at once by a second one: it was asked to quit, after the runs had left."""
    monkeypatch.setenv("STANDIN_TELL", f"{VISIBLE} {PIPE}")
    monkeypatch.setenv("STANDIN", f'{{"other": "{"hang" if signals == 2 else "gate" if signals else "train"}"}}')
    root = tmp_path / "results"
    command = [sys.executable, "-c", PARENT, str(root)]
    with subprocess.Popen(command, cwd=Path(__file__).parents[3], start_new_session=True) as process:
        if signals:
            layout, assigned = prepare(root, range(2), on_cards=range(2))
            half_way(layout, assigned)
        for _ in range(signals):
            os.killpg(process.pid, signal.SIGINT)
            time.sleep(1.0)  # two at once would be one
        code = process.wait(60)
    assert code == (Exit.DONE, Exit.INCOMPLETE, Exit.INTERRUPTED)[signals]
    started, left = daemon.read_text().splitlines()
    assert started.startswith("-d ")
    assert left.startswith(" / quit / ")


def test_how_many_runs_pay() -> None:
    """Up to the last number that brought a tenth more than half of it; memory is not filled to the brim."""
    assert Rates({1: 100.0, 2: 190.0, 4: 340.0, 8: 350.0}, 2**30).best == 4
    assert Rates({1: 100.0, 2: 105.0}, 2**30).best == 1
    assert Rates({1: 100.0}, 2**30).best == 1
    assert Rates({1: 100.0, 2: 190.0}, 2**30).each == 95.0
    assert Rates({1: 100.0}, 2**30).fitting(10 * 2**30) == 9


@pytest.mark.slow
@pytest.mark.sim
def test_the_trial_rehearsed_on_the_processor() -> None:
    """Real workers train a real run, more at a time until there are no more cores; and no more than memory holds."""
    counts: list[int] = []
    place = Place(device="cpu", memory=2**40, cores=2, warm_up=110, seconds=0.5)
    rates = measure(place, lambda count, rate: counts.append(count))
    assert counts == [1, 2]
    assert all(1.0 < rate < 1e5 for rate in rates.steps_per_s.values())
    assert 2**26 < rates.run_bytes < 2**34
    small = Place(device="cpu", memory=rates.run_bytes, cores=2, warm_up=110, seconds=0.5)
    assert list(measure(small, lambda *_: None).steps_per_s) == [1]
