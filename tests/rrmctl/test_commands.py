"""Commands in messages are ones that the program takes."""

import shlex

import pytest

from rrmctl.commands import assigned, run_command
from rrmctl.planning.settings import _value


@pytest.mark.parametrize(
    "value", [True, 64, 0.5, "bfloat16", "true", "nan", "a b", "3", "priors/mine.py:reward", "", [1, 2], ["a", "b"]]
)
def test_a_setting_is_read_back(value):
    """What a command says after --set is the value that it was told of, with its type."""
    assert _value(assigned(value), "--set") == value


def test_a_command_is_one_a_shell_takes():
    """Names once each, a single seed as a list, and quotes where a word needs them."""
    names = {"tasks": ["t", "t"], "methods": ["m", "n"]}
    told = run_command("e", "laptop", {"a.b": "c d"}, **names, seeds=[3], results="my runs")
    assert shlex.split(told) == [
        "rrmctl", "run", "e", "--profile", "laptop", "--set", 'a.b="c d"', "--tasks", "t", "--methods", "m,n",
        "--seeds", "3,", "--results", "my runs",
    ]  # fmt: skip
