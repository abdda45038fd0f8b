"""Costs: the table against hand-worked numbers, and stored speeds before the table."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import pytest

from rrm.config import KINDS
from rrm.envs import TASKS
from rrm.rewards import LEARNERS
from rrm.training.run_config import RunConfig
from rrmctl.cli.request import Forecast, forecast, in_words
from rrmctl.planning import cost, manifest
from rrmctl.planning.cost import core_speed, estimate_seconds, tabled_seconds
from rrmctl.planning.plan import Plan, make_plan
from rrmctl.store.layout import Layout
from rrmctl.store.status import RunState, Status, stored_speeds, write_status
from rrmctl.store.sweeps import SweepRecord, record_sweep


def toy(**options: Any) -> Plan:
    table = {
        "title": "T", "reproduces": ["F"], "rule": "R", "seeds": 2,
        "grid": {"tasks": ["toy-car"], "methods": ["oracle", "pebble"]},
    }  # fmt: skip
    return make_plan(manifest.parse(table, Path("mine.toml")), **options)


def oracle(**changes: Any) -> RunConfig:
    return RunConfig.model_validate(
        {"task": "button-press", "seed": 0, "steps": 25_000, "reward": {"learner": "true"}, **changes}
    )


def test_known_reward_by_hand() -> None:
    """Twenty-five thousand steps of the paper's SAC: start, simulation, updates and evaluation, added up on paper."""
    steps = 25_000 + 3 * 10 * 500  # evaluated at 10k, 20k and the end
    assert tabled_seconds(oracle(), 1.0) == pytest.approx(3 + steps * 0.00042 + 24_000 * (0.00016 + 0.010))


def test_a_faster_core_costs_less() -> None:
    """Time falls with the core's speed, but never below what does not multiply matrices."""
    slow, fast, limit = (tabled_seconds(oracle(), speed) for speed in (0.1, 1.0, 1e20))
    assert slow > fast > limit > 25_000 / 1800


def test_what_costs_more() -> None:
    """More steps, larger batches, networks and more evaluations cost more; so does a reward that must be learned."""
    base = tabled_seconds(oracle(), 1.0)
    pebble = tabled_seconds(oracle(reward={"learner": "pebble"}), 1.0)
    surf = tabled_seconds(oracle(reward={"learner": "surf"}), 1.0)
    assert surf > pebble > base
    for dearer in (
        {"agent": {"batch": 1024}}, {"agent": {"hidden": 512}}, {"agent": {"early_steps": 20_000}},
        {"evaluation": {"every": 1000}}, {"steps": 40_000},
    ):  # fmt: skip
        assert tabled_seconds(oracle(**dearer), 1.0) > base


def test_passes_that_are_allowed_and_not_needed_cost_nothing() -> None:
    """A session ends once its labels are told right, long before many passes are over; without that end all count."""

    def pebble(**reward: Any) -> float:
        return tabled_seconds(oracle(reward={"learner": "pebble", **reward}), 1.0)

    assert pebble(epochs=50) == pebble(epochs=500) > pebble(epochs=5)
    assert pebble(epochs=50, target_accuracy=1.0) > pebble(epochs=50)


@pytest.mark.parametrize(
    ("task", "learner", "sizes", "hours"),
    [
        ("button-press", "pebble", {"hidden": 256, "layers": 3, "batch": 512}, 1.5),
        ("button-press", "surf", {"hidden": 256, "layers": 3, "batch": 512}, 3.8),
        ("walker-walk", "true", {"hidden": 128, "layers": 3, "batch": 128}, 0.16),
        ("toy-car", "pebble", {"hidden": 64, "layers": 2, "batch": 64}, 0.045),
    ],
)
def test_order_of_magnitude(task: str, learner: str, sizes: dict[str, Any], hours: float) -> None:
    """Networks of other sizes are estimated within a factor of two of what their steps take (SURF's: in proportion)."""
    reward = {"learner": learner, "hidden": sizes["hidden"], "layers": sizes["layers"]}
    config = RunConfig.model_validate({"task": task, "seed": 0, "steps": 400_000, "agent": sizes, "reward": reward})
    assert hours / 2 < tabled_seconds(config, 1.0) / 3600 < hours * 2


def test_seeds_cost_the_same(tmp_path: Path) -> None:
    """The estimate covers every job, adds up, and says that it is an estimate."""
    plan = toy(seeds="3")
    expected = forecast(plan, Layout(tmp_path))
    assert set(expected.seconds) == {job.id for job in plan.jobs}
    assert len(set(expected.seconds.values())) == 2
    assert expected.hours_left == pytest.approx(sum(expected.seconds.values()) / 3600)
    assert "(an estimate" in in_words(expected, 1)


def test_only_what_is_left_is_counted() -> None:
    """A finished job costs nothing more, one half done half as much."""
    plan = toy(seeds="1")
    seconds = estimate_seconds(plan, {(job.task, job.method, "paper"): 100.0 for job in plan.jobs})
    assert list(seconds.values()) == [3 + 15_000 / 100] * 2
    states = (Status(state=RunState.DONE), Status(state=RunState.INTERRUPTED, step=7500, steps=15_000))
    expected = Forecast(plan, dict(zip(seconds, states, strict=True)), seconds, measured=2)
    assert expected.hours_left == pytest.approx(0.5 * (3 + 15_000 / 100) / 3600)
    assert in_words(expected, 1).endswith("(from the speed of stored runs).")


def store(root: Path, plan: Plan, *states: Status) -> Layout:
    """A results root in which the plan's first runs are in these states."""
    layout = Layout(root)
    names = {"experiment": plan.experiment, "variant": plan.variant, "profile": plan.profile}
    record_sweep(layout, SweepRecord(**names, jobs=plan.jobs))
    for job, status in zip(plan.jobs, states, strict=False):
        folder = layout.run(job.id)
        folder.path.mkdir(parents=True)
        write_status(folder, status)
    return layout


def test_stored_speeds_come_first(tmp_path: Path) -> None:
    """Runs in the store give the speed of their task, method and variant; the table serves for the rest."""
    plan = toy()
    done = Status(state=RunState.DONE, step=15_000, steps=15_000, wall_s=30.0, steps_per_s=1.0)
    layout = store(tmp_path, plan, done)
    rates = stored_speeds(layout)
    assert rates == {("toy-car", "oracle", "paper"): 500.0}
    expected = forecast(plan, layout)
    assert [expected.seconds[job.id] for job in plan.jobs if job.method == "oracle"] == [33.0] * 2
    assert "2 of 4 jobs from the speed of stored runs, the rest an estimate" in in_words(expected, 1)
    assert forecast(toy(overrides=["agent.batch=8"]), layout).measured == 0


def test_speed_of_unfinished_runs(tmp_path: Path) -> None:
    """An unfinished run tells its latest speed; the median over seeds counts; a run that never moved says nothing."""
    plan = toy(methods=["oracle"], seeds="4")
    speeds = [Status(state=RunState.INTERRUPTED, step=10, steps=15_000, steps_per_s=s) for s in (100.0, 400.0, 200.0)]
    assert stored_speeds(store(tmp_path, plan, *speeds, Status())) == {("toy-car", "oracle", "paper"): 200.0}


def test_states_that_are_known_are_not_read_again(tmp_path: Path) -> None:
    """What a command has read already it need not find a second time; the other runs are looked up."""
    plan = toy(methods=["oracle"], seeds="2")
    layout = store(tmp_path, plan, *[Status(state=RunState.DONE, step=100, wall_s=1.0)] * 2)
    known = {plan.jobs[0].id: Status(state=RunState.DONE, step=300, wall_s=1.0)}
    assert stored_speeds(layout, known) == {("toy-car", "oracle", "paper"): 200.0}


def test_empty_store(tmp_path: Path) -> None:
    """Nothing stored, nothing known."""
    assert stored_speeds(Layout(tmp_path / "absent")) == {}


def test_the_table_speaks_of_what_exists() -> None:
    """Every suite, task and learner that it has a number for is one."""
    table = tomllib.loads(Path(cost.__file__).with_name("costs.toml").read_text())
    assert set(table["step"]) - {"unknown"} <= {*TASKS, *(task.suite for task in TASKS.values())}
    assert set(table["learner"]) - {"default"} <= {*LEARNERS, *KINDS}


def test_this_core_multiplies() -> None:
    """The measurement gives a speed that a processor can have."""
    assert 1e-3 < core_speed() < 1e3


def test_one_command_goes_by_one_speed() -> None:
    """The speed of the core is measured once, and every estimate takes the same."""
    assert core_speed() is core_speed()
