"""--device, --gpus, --per-gpu and `doctor --tune`, with cards that are said to be there, and without any."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Collection
from pathlib import Path
from typing import NamedTuple

import pytest

from rrm import devices
from rrm.devices import Card
from rrmctl.cli import executors
from rrmctl.cli.executors import Options
from rrmctl.cli.request import Request, forecast, in_words, smaller
from rrmctl.errors import Exit, UserError
from rrmctl.planning import card_rates, cost
from rrmctl.planning.card_rates import Rates
from rrmctl.planning.cost import card_speed, trial
from rrmctl.running import tune
from rrmctl.running.local import LocalExecutor
from rrmctl.store.layout import Layout
from rrmctl.store.provenance import read_config
from rrmctl.store.records import write_json
from rrmctl.store.status import RunState
from tests.rrmctl.cli.test_run import EXPERIMENTS, PLAN, call, settle, start

RUN = ["run", *PLAN, "--methods", "oracle", "--seeds", "1"]
RATES = Rates({1: 300.0, 2: 590.0, 4: 1000.0, 8: 1050.0}, 2**30)


@pytest.fixture(autouse=True)
def _no_card(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Whatever this machine has, and whatever was measured here."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.delenv("CUDA_VISIBLE_DEVICES", raising=False)
    monkeypatch.setattr(devices, "cards", lambda: ())
    monkeypatch.setattr(cost, "cards", lambda: ())


@pytest.fixture
def there(monkeypatch: pytest.MonkeyPatch) -> Callable[..., list[Card]]:
    """Say that there are cards of these names, and so many cores."""

    def say(*names: str, cores: int = 64) -> list[Card]:
        cards = [Card(at, name, 80 * 2**30) for at, name in enumerate(names)]
        for module in (devices, cost):
            monkeypatch.setattr(module, "cards", lambda: tuple(cards))
        monkeypatch.setattr(devices, "cuda_of_torch", lambda: "12.8")
        monkeypatch.setattr(executors, "usable_cores", lambda: cores)
        return cards

    return say


def asked(device: str | None, *overrides: str) -> Request:
    return Request("toy-car", EXPERIMENTS, profile="smoke", overrides=list(overrides), device=device)


@pytest.mark.slow
def test_no_card_no_run(tmp_path: Path) -> None:
    """The program says in one message what is missing, and leaves with 2; nothing is written."""
    env_says = start(*RUN, "--device", "cuda", "--results", tmp_path / "results")
    _, told = env_says.communicate(timeout=60)
    if env_says.returncode == 0:
        pytest.skip("this machine has a card")
    assert env_says.returncode == 2
    assert told.startswith("error: device: cuda cannot be used here: ")
    assert len(told.splitlines()) == 1
    assert not (tmp_path / "results").exists()


def test_no_card_no_resume(tmp_path: Path) -> None:
    """Runs that were planned for a card elsewhere are not begun here; those that are done need none."""
    (run,) = settle(tmp_path, RunState.INTERRUPTED, "1")
    call(*RUN, "--executor", "slurm", "--results", tmp_path)  # records it
    folder = Layout(tmp_path).run(run)
    write_json(folder.config, read_config(folder) | {"device": "cuda"})
    result = call("resume", "--results", tmp_path)
    assert result.exit_code == 2
    assert "error: device: cuda cannot be used here: " in result.stderr
    settle(tmp_path, RunState.DONE, "1")
    assert call("resume", "--results", tmp_path).exit_code == 0


def test_the_device_is_a_setting() -> None:
    """--device says it in short; which card it is belongs to the command, and makes no other experiment."""
    plan = asked("cuda:1").plan()
    assert plan.overrides == {"device": "cuda"}
    assert {config.device for config in plan.configs.values() if config.kind == "train"} == {"cuda"}
    assert plan.variant == asked(None, "device=cuda").plan().variant == asked(None, 'device="cuda:3"').plan().variant
    assert asked("cpu").plan().configs.keys() == asked(None).plan().configs.keys()
    assert asked("auto").plan().overrides == {"device": "cpu"}


@pytest.mark.parametrize(
    ("device", "overrides", "card"),
    [("cuda:1", (), "1"), (None, ("device=cuda:2",), "2"), ("cuda", (), None), ("auto", (), None), (None, (), None)],
)
def test_a_card_that_is_asked_for(device: str | None, overrides: tuple[str, ...], card: str | None) -> None:
    """Its number is what --gpus would say."""
    assert asked(device, *overrides).card == card


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--device", "gpu"], "--device is gpu"),
        (["--device", "cuda:-1"], "--device is cuda:-1"),
        (["--device", "cpu", "--set", "device=cuda"], "--device cpu and --set device=cuda set one setting"),
        (["--set", "device=gpu"], "device = 'gpu'"),
    ],
)
def test_devices_that_are_none(tmp_path: Path, options: list[str], message: str) -> None:
    """In one line."""
    result = call(*RUN, *options, "--results", tmp_path / "results")
    assert result.exit_code == 2
    assert message in result.stderr
    assert not (tmp_path / "results").exists()


def test_how_many_runs_there_are_at_a_time(there: Callable[..., list[Card]], tmp_path: Path) -> None:
    """One on each card, or as many as paid when it was measured, while there are cores; what is typed wins."""
    a, _ = there("NVIDIA A", "NVIDIA A")

    def local(**options: object) -> Options:
        return Options(executor="local", **options)  # type: ignore[arg-type]

    assert local().cards(1).rooms == {"0": 1, "1": 1}
    assert local().slots([1], 9, 9) == 2
    card_rates.keep(a, RATES)
    assert local().cards(1).rooms == {"0": 4, "1": 4}
    assert local().slots([1], 99, 99) == 8
    assert local(workers=3).slots([1], 99, 99) == 3
    assert local().slots([1], 99, 9) == 64  # the others are on the processor
    assert local(gpus="1", per_gpu=16).cards(1).rooms == {"1": 16}
    assert local(gpus="1", per_gpu=16).slots([1], 99, 99) == 16
    there("NVIDIA A", "NVIDIA A", cores=6)
    assert local().cards(1).rooms == {"0": 3, "1": 3}
    assert local().cards(3).rooms == {"0": 1, "1": 1}
    card_rates.keep(a, Rates(RATES.steps_per_s, 40 * 2**30))
    assert local().cards(1).rooms == {"0": 1, "1": 1}
    with pytest.raises(UserError, match="there is no card 2 here") as caught:
        local(gpus="0,2").cards(1)
    assert caught.value.hint == "cards here: cuda:0 (NVIDIA A, 80 GiB), cuda:1 (NVIDIA A, 80 GiB)"


def test_cards_are_those_of_the_users_list(there: Callable[..., list[Card]], monkeypatch: pytest.MonkeyPatch) -> None:
    """Numbers index into CUDA_VISIBLE_DEVICES."""
    there("NVIDIA A", "NVIDIA A")
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "5,7")
    assert Options(executor="local", gpus="1").cards(1).rooms == {"7": 1}


def test_a_plan_of_runs_on_cards_that_nobody_has_measured(tmp_path: Path) -> None:
    """It is made anywhere, and invents no number."""
    result = call("plan", *PLAN, "--device", "cuda", "--results", tmp_path)
    assert result.exit_code == 0
    assert "How long it takes is not known: nobody has measured a card" in result.stdout
    assert "`rrmctl doctor --tune` does" in result.stdout
    assert "--profile" not in result.stdout
    said = json.loads(call("plan", *PLAN, "--device", "cuda", "--json", "--results", tmp_path).stdout)
    assert {job["core_seconds"] for job in said["jobs"]} == {None}
    assert (said["core_hours"], said["unknown"]) == (0, len(said["jobs"]))


def test_a_plan_goes_by_the_cards_own_rates(there: Callable[..., list[Card]], tmp_path: Path) -> None:
    """The trial's own run would take what it took there; a slower card takes longer."""
    (card,) = there("NVIDIA A")
    card_rates.keep(card, RATES)
    config = trial("cuda", 0)
    speed = card_speed()
    assert speed is not None
    assert cost.tabled_seconds(config, speed) == pytest.approx(config.steps / 250.0, rel=0.01)
    request = asked("cuda")
    expected = forecast(request.plan(), Layout(tmp_path))
    assert expected.unknown == 0
    told = in_words(expected, 4)
    assert "on the cards, 4 runs at a time (an estimate from the measured speed of one core or of a card" in told
    card_rates.keep(card, Rates({1: 100.0}, 2**30))
    assert forecast(request.plan(), Layout(tmp_path)).hours_left > expected.hours_left
    assert smaller(request, request.plan())


def test_what_is_kept_is_that_of_a_card(there: Callable[..., list[Card]]) -> None:
    """Another card's figures are no help, and neither are damaged ones."""
    a, b = there("NVIDIA A", "NVIDIA B")
    card_rates.keep(a, RATES)
    assert card_rates.read(a) == RATES
    assert card_rates.read(b) is None
    for text in ("{", "[]", '{"steps_per_s": {}, "run_bytes": 1}', '{"steps_per_s": {"1": -3}, "run_bytes": 1}'):
        card_rates.place(a).write_text(text)
        assert card_rates.read(a) is None


def test_tuning_measures_each_kind_of_card_once(
    there: Callable[..., list[Card]], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """What was found is printed and kept."""
    cards, measured = there("NVIDIA A", "NVIDIA A", "NVIDIA B", cores=16), []

    def measure(place: tune.Place, told: Callable[[int, float], None]) -> Rates:
        measured.append((place.card, place.memory, place.device))
        told(1, 300.0)
        return RATES

    monkeypatch.setattr(tune, "measure", measure)
    result = call("doctor", "--tune")
    assert result.exit_code == 0, result.output
    assert measured == [("0", 80 * 2**30, "cuda"), ("2", 80 * 2**30, "cuda")]
    assert "NVIDIA B: 4 runs at a time (1: 300, 2: 590, 4: 1,000, 8: 1,050 steps/s together" in result.stdout
    assert [card_rates.read(card) for card in cards] == [RATES] * 3
    assert json.loads(call("doctor", "--tune", "--json").stdout)["NVIDIA A"]["best"] == 4


def test_tuning_with_mps_is_kept_by_itself(
    there: Callable[..., list[Card]], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """What runs bear that share a card's work says nothing of those that take turns; `run --mps` goes by it."""
    (card,), measured = there("NVIDIA A", cores=16), []
    control = tmp_path / "bin" / "nvidia-cuda-mps-control"
    control.parent.mkdir()
    control.write_text("#!/bin/sh\n")
    control.chmod(0o755)
    monkeypatch.setenv("PATH", f"{control.parent}:{os.environ['PATH']}")
    monkeypatch.setattr(tune, "measure", lambda place, _told: measured.append(place.variables) or RATES)
    result = call("doctor", "--tune", "--mps")
    assert result.exit_code == 0, result.output
    assert set(measured[0]) == {"CUDA_MPS_PIPE_DIRECTORY", "CUDA_MPS_LOG_DIRECTORY"}
    assert (card_rates.read(card, mps=True), card_rates.read(card)) == (RATES, None)
    rooms = [sum(Options(executor="local", mps=mps).cards(1).rooms.values()) for mps in (False, True)]
    assert rooms == [1, 4]


def test_there_is_nothing_to_tune_without_a_card() -> None:
    """One message and 2."""
    result = call("doctor", "--tune")
    assert result.exit_code == 2
    assert "device: cuda cannot be used here" in result.stderr


class Driven(NamedTuple):
    """What the pool is given."""

    executor: LocalExecutor
    slots: int
    on_cards: Collection[str]
    places: int


@pytest.fixture
def driven(monkeypatch: pytest.MonkeyPatch) -> list[Driven]:
    """Pools that commands would begin, and do not."""
    pools: list[Driven] = []

    def drive(
        work: object, executor: LocalExecutor, slots: int, on_cards: Collection[str] = (), places: int = 0
    ) -> Exit:
        pools.append(Driven(executor, slots, on_cards, places))
        return Exit.INCOMPLETE

    monkeypatch.setattr(executors, "_drive", drive)
    return pools


@pytest.mark.slow
def test_the_pool_of_a_sweep_on_cards(tmp_path: Path, there: Callable[..., list[Card]], driven: list[Driven]) -> None:
    """All its runs need a place on one of the cards that are named; resumed, on any."""
    there("NVIDIA A", "NVIDIA B")
    asked = [*RUN, "--seeds", "8", "--device", "cuda:1", "--results", tmp_path]
    call(*asked)
    call(*asked, "--gpus", "0,1", "--per-gpu", "3")
    call("resume", "--workers", "5", "--per-gpu", "3", "--results", tmp_path)
    assert [pool.executor.cards and pool.executor.cards.rooms for pool in driven] == [
        {"1": 1}, {"0": 3, "1": 3}, {"0": 3, "1": 3}
    ]  # fmt: skip
    assert [(pool.slots, len(pool.on_cards), pool.places) for pool in driven] == [(1, 8, 1), (6, 8, 6), (5, 8, 6)]


def test_the_pool_by_way_of_a_service(
    tmp_path: Path, there: Callable[..., list[Card]], driven: list[Driven], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its clients count the cards that it was started on, and find it by its own folders."""
    there("NVIDIA A", "NVIDIA B")
    control = tmp_path / "bin" / "nvidia-cuda-mps-control"
    control.parent.mkdir()
    control.write_text(f'#!/bin/sh\necho "$CUDA_VISIBLE_DEVICES $*" >> {tmp_path}/calls\n')
    control.chmod(0o755)
    monkeypatch.setenv("PATH", f"{control.parent}:{os.environ['PATH']}")
    call(*RUN, "--device", "cuda", "--gpus", "1", "--mps", "--results", tmp_path / "results")
    cards = driven[0].executor.cards
    assert cards is not None
    assert cards.rooms == {"0": 1}
    assert cards.variables.keys() == {"CUDA_MPS_PIPE_DIRECTORY", "CUDA_MPS_LOG_DIRECTORY"}
    assert (tmp_path / "calls").read_text().splitlines()[0] == "1 -d"


@pytest.mark.parametrize("option", [["--gpus", "0"], ["--per-gpu", "2"], ["--mps"]])
def test_options_of_cards_without_runs_on_them(tmp_path: Path, option: list[str], driven: list[Driven]) -> None:
    """A note says that they change nothing."""
    result = call(*RUN, *option, "--results", tmp_path)
    assert "note: none of these runs is on a card: --gpus, --per-gpu and --mps change nothing" in result.stderr
    assert driven[0].executor.cards is None
