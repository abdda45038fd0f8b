"""The rows of a manifest's grids, and how each becomes the configuration of its runs: layers of settings.

Settings, widest first: the library's defaults, the profile (by suite, task and kind of method), then the manifest's
[defaults], the grid's `set`, [task.NAME], [feedback.NAME], the teacher, [method.NAME], an include's `set`,
[profile.NAME], and `--set` last.

A manifest's amounts (steps, feedback, seed steps ...) are written at the paper's scale. In another profile they shrink
as that profile's own number for the task does: `every = 20_000` on a task whose paper schedule is 5000 means four
times whatever the profile asks. [profile.NAME] and `--set` are taken as they stand.
"""

from __future__ import annotations

import itertools
import math
from collections import ChainMap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, get_args

from rrm.config import RewardConfig
from rrm.envs.tasks import TASKS
from rrm.teachers import TEACHERS
from rrm.training.run_config import RunConfig
from rrmctl.errors import UserError, check_known
from rrmctl.labels import HUMAN, NOTHING_ASKED, Schedule
from rrmctl.planning.manifest import DEFAULT_FEEDBACK, Axis, Grid, Manifest
from rrmctl.planning.methods import TASK, Method
from rrmctl.planning.profiles import PAPER, PATH, ProfileKind, profiles
from rrmctl.planning.settings import Layer, fields, merged, resolve

#: The axes of a grid in the order in which rows vary, the last one fastest, and what a row calls its value.
AXES: dict[Axis, str] = {"tasks": "task", "methods": "method", "teachers": "teacher", "feedback": "feedback"}

#: Each is configured by itself: some ten milliseconds.
_MOST_ROWS = 5000

#: Settings that say how long, how often and how much: the ones a profile shrinks in a manifest's numbers.
AMOUNTS = (
    "steps",
    "feedback.every", "feedback.batch", "feedback.budget", "feedback.segment", "feedback.window",
    "exploration.seed_steps", "exploration.unsupervised_steps",
    "evaluation.every",
    *(f"reward.{name}.{amount}" for name, section in RewardConfig.own().items() for amount in section.amounts),
    "agent.stddev_steps", "agent.perturb_every",
    "deploy.checkpoints",
    "imitation.steps", "imitation.seed_steps", "imitation.every", "imitation.window", "imitation.switch",
)  # fmt: skip

#: Kinds of section by name, and the fields of a manifest that hold them.
_FIELDS = {"task": "tasks", "profile": "profiles", "teacher": "teachers", "feedback": "feedback"}

#: What a label of feedback spells out; a schedule that sets anything else is named in it.
_SPELLED = {"batch", "every", "budget"}


@dataclass(frozen=True)
class GridRow:
    """One row of a grid, before seeds."""

    task: str
    method: str
    teacher: str
    feedback: str
    grid: Layer  #: the `set` of its grid
    own: Layer  #: the `set` of the include it comes from


def rows_of(manifest: Manifest) -> list[GridRow]:
    """Every row, in the manifest's order.

    Paired axes of different lengths, an exclude that matches or leaves nothing, and too many rows are refused.
    """
    rows: dict[GridRow, None] = {}
    for number, grid in enumerate(manifest.grids, start=1):
        where = f"{manifest.path} [[grid]] {number}" if len(manifest.grids) > 1 else f"{manifest.path} [grid]"
        rows |= dict.fromkeys(_grid_rows(grid, where))
        _refuse_many(len(rows), where)
    return list(rows)


def _refuse_many(rows: int, where: str) -> None:
    if rows > _MOST_ROWS:
        raise UserError(f"{where}: {rows:,} rows; an experiment has at most {_MOST_ROWS:,}", "divide it into several")


def _grid_rows(grid: Grid, where: str) -> list[GridRow]:
    rows = _crossed(grid, where)
    for excluded in grid.exclude:
        left = [row for row in rows if not excluded.given.items() <= vars(row).items()]
        if len(left) == len(rows):
            raise UserError(f"{where} exclude {excluded}: no row of the grid is like that")
        rows = left
    if not rows:
        raise UserError(f"{where}: exclude leaves no row")
    added = []
    for entry in grid.include:
        changes: dict[str, Any] = {**entry.given, "own": Layer.read(f"{where} include {entry} set", entry.set)}
        added += [replace(row, **changes) for row in rows]
    return rows + added


def _crossed(grid: Grid, where: str) -> list[GridRow]:
    """Every combination of the axes; those of a `zip` advance together."""
    paired = {axis: group for group in grid.zip for axis in group}
    choices = []
    for group in dict.fromkeys(paired.get(axis, (axis,)) for axis in AXES):
        values = [getattr(grid, axis) for axis in group]
        if len(set(map(len, values))) > 1:
            lengths = ", ".join(f"{len(names)} {axis}" for axis, names in zip(group, values, strict=True))
            raise UserError(f"{where} zip: paired axes must be equally long; there are {lengths}")
        places = [AXES[axis] for axis in group]
        choices.append([dict(zip(places, names, strict=True)) for names in zip(*values, strict=True)])
    _refuse_many(math.prod(map(len, choices)) * (1 + len(grid.include)), where)
    layer, own = Layer.read(f"{where} set", grid.set), Layer(f"{where} include", {})
    return [GridRow(**ChainMap(*names), grid=layer, own=own) for names in itertools.product(*choices)]


def check(manifest: Manifest, rows: Sequence[GridRow]) -> None:
    """Refuse unknown names, sections for names that the grid does not have, and settings that cannot be.

    Settings are checked also in sections and profiles that a plan does not use.
    """
    for row in rows:
        for kind, name, defined in (
            ("task", row.task, TASKS),
            ("teacher", row.teacher, {**TEACHERS, **manifest.teachers}),
            ("feedback schedule", row.feedback, {DEFAULT_FEEDBACK, *manifest.feedback}),
        ):
            check_known(name, sorted(defined), f'{manifest.path}: unknown {kind} "{name}"')
    for axis, kind in AXES.items():
        used = sorted({getattr(row, kind) for row in rows})
        for name in getattr(manifest, axis):
            problem = f"{manifest.path} [{kind}.{name}]: the grid has no {kind} of this name"
            check_known(name, used, problem, "the grid has")
    for kind, field in _FIELDS.items():
        for name in getattr(manifest, field):
            _layer(manifest, kind, name)
    for name in manifest.profiles:
        check_known(name, profiles(), f"{manifest.path} [profile.{name}]: no profile has this name")


def configure(manifest: Manifest, row: GridRow, method: Method, scale: str, overrides: Mapping[str, Any]) -> RunConfig:
    """The configuration of the row's runs, with seed 0, in the profile `scale` and with overrides of `--set`."""
    decided = {"task": row.task, "seed": 0, "profile": scale, "reward.learner": method.learner}
    if method.prior is not None:
        decided["reward.prior"] = method.prior.replace(TASK, row.task)
    if method.agent is not None:
        decided["agent.kind"] = method.agent
    ratios = _ratios(scale, row.task, method.kind)
    at_paper_scale = (
        Layer.read(f"{manifest.path} [defaults]", manifest.defaults),
        row.grid,
        _layer(manifest, "task", row.task),
        _layer(manifest, "feedback", row.feedback),
        _layer(manifest, "teacher", row.teacher),
        Layer.read(f"{manifest.path} [method.{row.method}]", method.settings),
        row.own,
    )
    layers = (
        *profile_layers(scale, row.task, method.kind),
        *(_scaled(layer, ratios, scale) for layer in at_paper_scale),
        _layer(manifest, "profile", scale),
        Layer("--set", overrides),
    )
    return resolve(layers, f"{manifest.path}: {row.task}, {row.method}", **decided)


@cache
def profile_layers(scale: str, task: str, kind: ProfileKind) -> tuple[Layer, ...]:
    """What the profile sets for a task and a kind of method, widest first."""
    layers = []
    for name, table in profiles()[scale].chain:
        for section, named in (("all", None), ("suite", TASKS[task].suite), ("task", task)):
            settings = table.get(section, {}) if named is None else table.get(section, {}).get(named, {})
            where = f"{PATH.name} [{name}.{section}" + (f".{named}" if named else "")
            common = {key: value for key, value in settings.items() if key not in get_args(ProfileKind)}
            own = settings.get(kind, {})
            layers += [Layer.read(f"{where}]", common, usual=True), Layer.read(f"{where}.{kind}]", own, usual=True)]
    return tuple(layers)


def teacher_label(row: GridRow, config: RunConfig) -> str:
    """The teacher's name; people are called so also where a setting has put them in the place of one of ours."""
    if config.teacher is None:
        return NOTHING_ASKED
    return HUMAN if config.teacher.kind != "scripted" and row.teacher in TEACHERS else row.teacher


def feedback_label(manifest: Manifest, row: GridRow, config: RunConfig) -> str:
    """`50@5000/5000`: queries of a session, steps between sessions, queries in all; or that nothing is asked."""
    if config.feedback is None:
        return NOTHING_ASKED
    name = row.feedback if set(manifest.feedback.get(row.feedback, {})) - _SPELLED else ""
    return str(Schedule(config.feedback.batch, config.feedback.every, config.feedback.budget, name))


def _layer(manifest: Manifest, kind: str, name: str) -> Layer:
    """The manifest's section [kind.name], empty where it has none; a teacher's stands over the preset of its name."""
    settings = getattr(manifest, _FIELDS[kind]).get(name, {})
    if kind == "teacher":
        settings = {**TEACHERS.get(name, {}), **settings}
    tree = {kind: settings} if kind in ("teacher", "feedback") else settings
    return Layer.read(f"{manifest.path} [{kind}.{name}]", tree)


@cache
def _ratios(scale: str, task: str, kind: ProfileKind) -> dict[str, tuple[int, int]]:
    """For each amount (the profile's number, the paper's number); their quotient scales a manifest's."""
    defaults = {name: fields()[name][0].default for name in AMOUNTS}
    defaults["steps"] = 1  # a task of which no profile knows the length is not scaled
    ours, paper = (defaults | merged(profile_layers(name, task, kind)) for name in (scale, PAPER))
    total = (ours["steps"], paper["steps"])
    return {name: (ours[name], paper[name]) if paper[name] else total for name in AMOUNTS}


def _shrunk(amount: int, ours: int, paper: int) -> int:
    return max((2 * amount * ours + paper) // (2 * paper), min(amount, 1))


def _scaled(layer: Layer, ratios: Mapping[str, tuple[int, int]], scale: str) -> Layer:
    """The layer with its amounts as the profile has them, to the nearest integer; what was not zero stays so."""
    settings, written = dict(layer.settings), {}
    for name in settings.keys() & ratios.keys():
        value, (ours, paper) = settings[name], ratios[name]
        if isinstance(value, tuple):
            settings[name] = tuple(_shrunk(each, ours, paper) for each in value)
        else:
            settings[name] = _shrunk(value, ours, paper)
        if settings[name] != value:
            written[name] = f"{value!r}, {settings[name]!r} in profile {scale},"
    return Layer(layer.where, settings, written)
