"""Manifests: what a good one says, and what each kind of mistake is answered with."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from rrmctl.errors import UserError
from rrmctl.planning import manifest
from rrmctl.planning.settings import Layer

GOOD = """
title = "T"
reproduces = ["Fig. 1"]
rule = "IQM."
seeds = 3

[grid]
tasks = ["toy-car"]
methods = ["oracle", "pebble"]
"""


def write(folder: Path, text: str, name: str = "mine.toml") -> Path:
    path = folder / name
    path.write_text(text)
    return path


def refused(folder: Path, text: str) -> str:
    with pytest.raises(UserError) as caught:
        manifest.load(write(folder, text))
    return str(caught.value)


@pytest.mark.parametrize("precision", ["float32", "bfloat16", "auto"])
def test_a_precision_is_checked_by_itself(precision: str) -> None:
    """What "auto" means is settled later, where batch and hidden units are known."""
    assert Layer.read("here", {"precision": precision}).settings == {"precision": precision}
    with pytest.raises(UserError, match="precision = 'float16': Input should be 'float32', 'bfloat16' or 'tf32'"):
        Layer.read("here", {"precision": "float16"})


def test_small_manifest(tmp_path: Path) -> None:
    """A title, a figure, a rule and a grid are enough; the rest has defaults."""
    read = manifest.load(write(tmp_path, GOOD))
    assert (read.name, read.seeds, read.default_profile) == ("mine", 3, "paper")
    assert read.grids[0].teachers == ("oracle",)
    assert read.grids[0].feedback == ("default",)


def test_every_section(tmp_path: Path) -> None:
    """Sections land in their fields; learner and prior are told apart from a method's settings."""
    text = GOOD + (
        'zip = [["tasks", "methods"]]\n'
        'include = [{method = "rrm-zero", set = {agent.batch = 64}}]\n'
        'exclude = [{task = "toy-car"}]\n'
        "[task.toy-car]\nsteps = 5\n"
        '[method.pebble]\nprior = "p.py:f"\nagent.hidden = 8\n'
        "[teacher.tired]\nmistake = 0.5\n[feedback.rare]\nevery = 7\n"
        "[profile.smoke]\nsteps = 9\n[defaults]\nsteps = 1\n"
    )
    read = manifest.load(write(tmp_path, text))
    assert read.methods["pebble"].prior == "p.py:f"
    assert read.methods["pebble"].model_extra == {"agent": {"hidden": 8}}
    assert read.grids[0].include[0].set == {"agent": {"batch": 64}}
    assert (read.tasks, read.teachers) == ({"toy-car": {"steps": 5}}, {"tired": {"mistake": 0.5}})
    assert (read.feedback, read.profiles) == ({"rare": {"every": 7}}, {"smoke": {"steps": 9}})
    assert read.defaults == {"steps": 1}


def test_several_grids(tmp_path: Path) -> None:
    """[[grid]] may be written more than once."""
    text = GOOD.replace("[grid]", "[[grid]]") + '[[grid]]\ntasks = ["walker-walk"]\nmethods = ["oracle"]\n'
    assert [grid.tasks for grid in manifest.load(write(tmp_path, text)).grids] == [("toy-car",), ("walker-walk",)]


@pytest.mark.parametrize(
    ("before", "after", "said"),
    [
        ("title", "titel", 'unknown key "titel"; did you mean "title"?'),
        ("methods", "method", '[grid]: unknown key "method"; did you mean "methods"?'),
        ('["toy-car"]', "[]", "[grid] tasks is empty; name at least 1"),
        ('["toy-car"]', '"toy-car"', "[grid] tasks: Input should be a valid list; got 'toy-car'"),
        ('["toy-car"]', "[3]", "[grid] tasks.0: Input should be a valid string; got 3"),
        ('["toy-car"]', '["toy-car", "toy-car"]', "[grid] tasks: named twice: toy-car"),
        ('title = "T"', "title = 5", "title: Input should be a valid string; got 5"),
        ('title = "T"', "", "title is missing"),
        ("seeds = 3", "seeds = 2.5", "seeds: expected a number or a list of integers; got 2.5"),
        ("seeds = 3", "seeds = true", "seeds: expected a number or a list of integers; got True"),
        ("seeds = 3", 'seeds = "3"', "seeds: expected a number or a list of integers; got '3'"),
        ("seeds = 3", "seeds = [1, 0.5]", "seeds: expected a number or a list of integers; got [1, 0.5]"),
        ('["Fig. 1"]', "[]", "reproduces is empty"),
        ("seeds = 3", "seeds = ", "not valid TOML"),
        ("[grid]", "[gird]", 'unknown key "gird"; did you mean "grid"?'),
        ("[grid]", "[defaults]", "there is no [grid]"),
    ],
)
def test_mistakes_are_named(tmp_path: Path, before: str, after: str, said: str) -> None:
    """Each mistake names the file, the key and what is wrong."""
    message = refused(tmp_path, GOOD.replace(before, after))
    assert said in message
    assert "mine.toml" in message


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ('zip = [["tasks"]]', "[grid] zip.0 is too short; name at least 2"),
        ('zip = [["tasks", "methods"], ["tasks", "teachers"]]', "an axis can be paired once only: tasks"),
        ('zip = [["tasks", "seeds"]]', "[grid] zip.0.1"),
        ('exclude = [{tsk = "toy-car"}]', 'unknown key "tsk"; did you mean "task"?'),
        ("exclude = [{}]", "an empty entry matches every row"),
        ("include = 3", "[grid] include"),
        ("[method]\npebble = 3", "method.pebble"),
        ("[task]\ntoy-car = 3", "task.toy-car"),
    ],
)
def test_mistakes_in_the_grid(tmp_path: Path, line: str, said: str) -> None:
    """Pairings, includes and excludes are checked as well."""
    assert said in refused(tmp_path, GOOD + line)


def test_unreadable_files(tmp_path: Path) -> None:
    """Not text, not there, or not a name: a message each."""
    broken = tmp_path / "bytes.toml"
    broken.write_bytes(b"title = '\xff'")
    with pytest.raises(UserError, match="not UTF-8"):
        manifest.load(broken)
    os.mkfifo(tmp_path / "pipe.toml")
    for name in ("absent.toml", "pipe.toml"):
        with pytest.raises(UserError, match="cannot read"):
            manifest.load(tmp_path / name)
    with pytest.raises(UserError, match="name is made of"):
        manifest.load(write(tmp_path, GOOD, "two words.toml"))


def test_each_of_several_grids_is_told_apart(tmp_path: Path) -> None:
    """A mistake in the second grid says so; a grid is a table."""
    several = GOOD.replace("[grid]", "[[grid]]")
    added = several + '[[grid]]\ntasks = ["toy-car"]\nmethods = ["oracle"]\n'
    assert '[[grid]] 2: unknown key "sets"; did you mean "set"?' in refused(tmp_path, added + "sets = {}")
    said = refused(tmp_path, added + 'include = [{method = "pebble", setting = {}}]')
    assert '[[grid]] 2 include: unknown key "setting"' in said
    assert "[grid]: expected a table; got 3" in refused(tmp_path, f"grid = 3\n{GOOD.partition('[grid]')[0]}")
