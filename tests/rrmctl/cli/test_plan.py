"""Commands that look: `list`, `plan` and `doctor`."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner, Result

from rrmctl import doctor
from rrmctl.cli import plan
from rrmctl.cli.app import app as rrmctl
from rrmctl.cli.request import Request, duration, smaller
from rrmctl.errors import UserError
from rrmctl.planning.cost import estimate_seconds
from rrmctl.planning.profiles import profiles

EXPERIMENTS = Path(__file__).parents[3] / "experiments"

app = typer.Typer()
app.command("list")(plan.list_)
app.command("plan")(plan.plan)
app.command("doctor")(plan.doctor)


def call(*arguments: str, results: Path = Path("/nonexistent")) -> Result:
    names = ["--experiments", str(EXPERIMENTS)]
    where = ["--results", str(results)] if arguments[0] != "list" else []
    return CliRunner().invoke(app, [*arguments, *names, *where], catch_exceptions=False)


def test_list() -> None:
    """Every manifest is a line with its figure and its number of jobs; names of methods and profiles stand below."""
    result = call("list")
    lines = {line.split()[0]: line for line in result.stdout.splitlines()}
    assert {path.stem for path in EXPERIMENTS.glob("*.toml")} < set(lines)
    assert "Fig. mainbox" in lines["main-results"]
    assert "400" in lines["main-results"]
    assert "language" in lines["priors:"]
    assert "pebble" in lines["learners:"]
    assert lines["profiles:"] == f"profiles: {', '.join(profiles())}"
    for command in ("plan", "run"):  # their help names them too
        told = " ".join(re.sub(r"[│\n]+", " ", CliRunner().invoke(rrmctl, [command, "--help"]).stdout).split())
        assert all(re.search(rf"Scale:[^.]*\b{name}\b", told) for name in profiles())


def test_list_for_programs() -> None:
    """--json gives the same as data."""
    entries = {entry["name"]: entry for entry in json.loads(call("list", "--json").stdout)}
    assert entries["toy-car"]["jobs"] == 30
    assert entries["quickstart"]["profile"] == "quickstart"


def test_list_shows_the_good_ones_beside_a_bad_one(tmp_path: Path) -> None:
    """One broken manifest hides no other, and is named at the end."""
    (tmp_path / "good.toml").write_text((EXPERIMENTS / "toy-car.toml").read_text())
    (tmp_path / "bad.toml").write_text("titel = 3")
    result = CliRunner().invoke(app, ["list", "--experiments", str(tmp_path)])
    assert "\ngood " in result.stdout
    assert isinstance(result.exception, UserError)
    assert "bad.toml" in str(result.exception)


def test_plan_counts_and_costs() -> None:
    """A plan shows groups of seeds, the number of jobs, the cost, and how to go smaller."""
    text = call(
        "plan", "main-results", "--seeds", "2", "--tasks", "button-press,door-open", "--methods", "oracle"
    ).stdout
    assert "4 jobs, none run yet." in text
    assert "of one core are left" in text
    assert "--profile laptop: about" in text
    assert text.count("oracle") == 2
    assert "door-unlock" not in text


def test_plan_of_each_job(tmp_path: Path) -> None:
    """--jobs names every run; results that do not exist are empty, and are not made."""
    text = call("plan", "toy-car", "--seeds", "0,7", "--jobs", results=tmp_path / "none").stdout
    assert text.count("queued") == 6
    assert list(tmp_path.iterdir()) == []


def test_plan_for_programs() -> None:
    """--json holds every job with its id, labels and state, and the overrides."""
    said = json.loads(call("plan", "toy-car", "--set", "agent.batch=32", "--seeds", "1", "--json").stdout)
    assert said["overrides"] == {"agent.batch": 32}
    assert [job["method"] for job in said["jobs"]] == ["oracle", "pebble", "rrm-sparse"]
    assert {job["state"] for job in said["jobs"]} == {"queued"}
    assert said["core_hours_left"] == said["core_hours"] > 0


def test_plan_takes_a_path(tmp_path: Path) -> None:
    """A manifest anywhere can be planned by its path."""
    (tmp_path / "mine.toml").write_text((EXPERIMENTS / "toy-car.toml").read_text())
    assert call("plan", str(tmp_path / "mine.toml")).stdout.startswith("mine: ")


def test_plan_at_smoke_offers_nothing_smaller() -> None:
    """There is no cheaper profile than smoke; asking for a part of it remains."""
    text = call("plan", "toy-car", "--profile", "smoke").stdout
    assert "--profile" not in text
    assert "a part of it" in text


@pytest.mark.parametrize("seeds", ["5", "2,7,9", "4,"])
def test_cheaper_profiles_are_told_with_all_seeds(seeds: str) -> None:
    """The cost of a cheaper profile is that of the whole request in it, though one seed is planned to find out."""
    request = Request("main-results", experiments=EXPERIMENTS, seeds=seeds)
    advice = smaller(request, request.plan())
    whole = sum(estimate_seconds(replace(request, profile="laptop").plan(), {}).values()) / 3600
    assert advice[0].startswith(f"--profile laptop: about {duration(whole)} of one core")


def test_profiles_that_cannot_hold_the_request_are_no_advice() -> None:
    """A plan that only its own profile can hold is shown without a word on the others."""
    result = call("plan", "toy-car", "--profile", "smoke", "--set", "steps=450")
    assert result.exit_code == 0
    assert "jobs, none run yet" in result.stdout
    assert "--profile" not in result.stdout


def test_plan_says_what_will_not_be_asked_and_what_will_not_fit() -> None:
    """A budget that the run is too short for and threads that the machine lacks are notes beside the plan."""
    asked = ("--profile", "smoke", "--seeds", "2", "--set", "feedback.budget=1000000", "--set", "threads=4000")
    text = call("plan", "toy-car", *asked).stdout
    notes = [line.strip() for line in text.splitlines() if "note:" in line]
    for note, method in zip(notes, ("pebble", "rrm-sparse"), strict=False):
        assert re.fullmatch(rf"note: \d+ of 1,000,000 questions fit into 600 steps: toy-car {method}", note)
    assert re.fullmatch(r"note: threads: 4000 for each run, on \d+ cores?", notes[2])
    assert "note:" not in call("plan", "toy-car", "--profile", "smoke").stdout


@pytest.mark.parametrize(("state", "code"), [("ok", 0), ("note", 0), ("missing", 1)])
def test_doctor_says_what_is_missing(monkeypatch: pytest.MonkeyPatch, state: str, code: int) -> None:
    """Only something that is needed and missing ends with 1; the fix is printed below it."""
    checks = [doctor.Check("thing", state, "as found", "do this")]  # type: ignore[arg-type]
    monkeypatch.setattr(doctor, "examine", lambda results, experiments: checks)
    result = call("doctor")
    assert result.exit_code == code
    assert "as found" in result.stdout
    assert "fix: do this" in result.stdout
    assert json.loads(call("doctor", "--json").stdout)[0]["state"] == state


@pytest.mark.slow
@pytest.mark.sim
def test_doctor_on_this_machine(tmp_path: Path) -> None:
    """A machine that runs the tests is ready."""
    result = call("doctor", results=tmp_path)
    assert result.exit_code == 0, result.stdout
    assert "Ready." in result.stdout
    assert "Meta-World, DM-Control and torch load" in result.stdout


@pytest.mark.parametrize(
    ("hours", "said"),
    [(0.01, "36 s"), (0.5, "30 min"), (3.456, "3.5 h"), (94, "94 h"), (480, "20 days")],
)
def test_durations(hours: float, said: str) -> None:
    """Durations are told in the unit that suits them."""
    assert duration(hours) == said
