"""Commands in messages are ones that the program takes."""

import shlex

import pytest

from rrmctl.commands import assigned, rrmctl, run_commands
from rrmctl.planning.settings import _value


@pytest.mark.parametrize(
    "value", [True, 64, 0.5, "bfloat16", "true", "nan", "a b", "3", "priors/mine.py:reward", "", [1, 2], ["a", "b"]]
)
def test_a_setting_is_read_back(value):
    """What a command says after --set is the value that it was told of, with its type."""
    assert _value(assigned(value), "--set") == value


def told(runs, **more):
    return [shlex.split(each) for each in run_commands("e", "laptop", {"a.b": "c d"}, runs, **more)]


def test_a_command_is_one_a_shell_takes():
    """Quotes where a word needs them, a single seed as a list."""
    assert told([("t", "m", 3), ("t", "n", 3)], results="my runs", options=["--force"]) == [
        ["rrmctl", "run", "e", "--profile", "laptop", "--set", 'a.b="c d"', "--tasks", "t", "--methods", "m,n",
         "--seeds", "3,", "--results", "my runs", "--force"]
    ]  # fmt: skip


def test_commands_ask_for_these_runs_and_no_other():
    """What is not the product of tasks, methods and seeds takes several."""
    runs = {("t", "m", 0), ("t", "m", 1), ("t", "n", 0), ("u", "m", 0)}
    asked = set()
    for words in told(sorted(runs)):
        options = dict(zip(words[3::2], words[4::2], strict=True))
        seeds = [int(each) for each in options["--seeds"].split(",") if each]
        asked |= {(options["--tasks"], name, seed) for name in options["--methods"].split(",") for seed in seeds}
    assert asked == runs


def test_what_was_asked_with_is_asked_with_again():
    """The manifest's path or its folder, and the priors of these methods alone."""
    asked = [
        "rrmctl",
        "run",
        "my/e.toml",
        "--experiments=a",
        "--prior",
        "p.py:one",
        "--prior",
        "p.py:two",
        "--seeds",
        "3",
    ]
    (words,) = told([("t", "rrm-one", 0)], asked=[asked, ["rrmctl", "resume"]])
    assert words[2] == "my/e.toml"
    assert words[7:11] == ["--experiments", "a", "--prior", "p.py:one"]


def test_the_results_folder_is_said_where_it_is_not_the_one_a_command_takes(monkeypatch):
    """That is `results`, or what the environment says."""
    monkeypatch.delenv("RRMCTL_RESULTS", raising=False)
    assert rrmctl("status", results="results") == "rrmctl status"
    assert rrmctl("status", results="a b") == "rrmctl status --results 'a b'"
    monkeypatch.setenv("RRMCTL_RESULTS", "a b")
    assert rrmctl("status", results="a b") == "rrmctl status"
    assert rrmctl("status", results="results") == "rrmctl status --results results"
