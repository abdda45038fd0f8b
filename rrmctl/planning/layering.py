"""One row of a grid becomes the configuration of its runs: layers of settings, scaled to the profile.

Settings, widest first: the library's defaults, the profile (by suite, task and kind of method), then the manifest's
[defaults], the grid's `set`, [task.NAME], [feedback.NAME], the teacher, [method.NAME], an include's `set`,
[profile.NAME], and `--set` last.

A manifest's amounts (steps, feedback, seed steps ...) are written at the paper's scale. In another profile they shrink
as that profile's own number for the task does: `every = 20_000` on a task whose paper schedule is 5000 means four
times whatever the profile asks. [profile.NAME] and `--set` are taken as they stand.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cache
from typing import Any

from rrm.config import EvaluationConfig, ExplorationConfig, FeedbackConfig, ImitationConfig, RewardConfig
from rrm.envs.tasks import TASKS
from rrm.teachers import TEACHERS
from rrm.training.run_config import RunConfig
from rrmctl.errors import check_known
from rrmctl.labels import NOTHING_ASKED
from rrmctl.planning.grid import GridRow
from rrmctl.planning.manifest import DEFAULT_FEEDBACK, Manifest
from rrmctl.planning.methods import TASK, Method
from rrmctl.planning.profiles import PAPER, Layer, ProfileKind, profiles
from rrmctl.planning.schedules import Schedule
from rrmctl.planning.settings import AMOUNTS, Checked, flatten, resolve

Flat = dict[str, Any]

#: What a label of feedback spells out; a schedule that sets anything else is named in it.
_SPELLED = {"batch", "every", "budget"}


def check_names(manifest: Manifest, row: GridRow) -> None:
    """Refuse a task, teacher or schedule of feedback that nothing defines.

    Raises:
        UserError: with the nearest known name.
    """
    for kind, name, known in (
        ("task", row.task, TASKS),
        ("teacher", row.teacher, {**TEACHERS, **manifest.teachers}),
        ("feedback schedule", row.feedback, {DEFAULT_FEEDBACK, *manifest.feedback}),
    ):
        check_known(name, sorted(known), f'{manifest.path}: unknown {kind} "{name}"')


def configure(manifest: Manifest, row: GridRow, method: Method, scale: str, overrides: Flat) -> RunConfig:
    """The configuration of the row's runs, with seed 0.

    Args:
        scale: the profile's name.
        overrides: of `--set`, checked.

    Raises:
        UserError: unknown key, wrong type, or settings that cannot be run together; names file, section and key.
    """
    decided: Flat = {"task": row.task, "seed": 0, "profile": scale, "reward.learner": method.learner}
    if method.prior is not None:
        decided["reward.prior"] = method.prior.replace(TASK, row.task)
    ratios = _ratios(scale, row.task, method.kind)
    layers = profile_layers(scale, row.task, method.kind)
    layers += [_scaled(layer, ratios, scale) for layer in _manifest_layers(manifest, row, method)]
    own = _section(manifest, "profile", manifest.profiles, scale)
    layers += [Checked(own.where, flatten(own)), Checked("--set", overrides)]
    return resolve(layers, f"{manifest.path}: {row.task}, {row.method}", **decided)


def profile_layers(scale: str, task: str, kind: ProfileKind) -> list[Checked]:
    """What the profile sets for a task and a kind of method, widest first."""
    return [Checked(layer.where, settings) for layer, settings in _profile_settings(scale, task, kind)]


def feedback_label(manifest: Manifest, row: GridRow, config: RunConfig) -> str:
    """`50@5000/5000`: queries of a session, steps between sessions, queries in all; or that nothing is asked."""
    if config.feedback is None:
        return NOTHING_ASKED
    name = row.feedback if set(manifest.feedback.get(row.feedback, {})) - _SPELLED else ""
    return str(Schedule(config.feedback.batch, config.feedback.every, config.feedback.budget, name))


def check_sections(manifest: Manifest) -> None:
    """Check every setting of the manifest, also of sections and profiles that a plan does not use.

    Raises:
        UserError: unknown key or wrong type; names file, section and key.
    """
    sections = [_section(manifest, "task", manifest.tasks, name) for name in manifest.tasks]
    sections += [_section(manifest, "profile", manifest.profiles, name) for name in manifest.profiles]
    sections += [_teacher(manifest, name) for name in manifest.teachers]
    sections += [_schedule(manifest, name) for name in manifest.feedback]
    for section in sections:
        flatten(section)
    known = profiles()
    for name in manifest.profiles:
        check_known(name, known, f"{manifest.path} [profile.{name}]: no profile has this name")


def _manifest_layers(manifest: Manifest, row: GridRow, method: Method) -> Iterator[Layer]:
    yield Layer(f"{manifest.path} [defaults]", manifest.defaults)
    yield row.grid
    yield _section(manifest, "task", manifest.tasks, row.task)
    yield _schedule(manifest, row.feedback)
    yield _teacher(manifest, row.teacher)
    yield Layer(f"{manifest.path} [method.{row.method}]", method.settings)
    yield row.own


def _section(manifest: Manifest, kind: str, sections: Mapping[str, Flat], name: str) -> Layer:
    return Layer(f"{manifest.path} [{kind}.{name}]", sections.get(name, {}))


def _schedule(manifest: Manifest, name: str) -> Layer:
    return Layer(f"{manifest.path} [feedback.{name}]", {"feedback": manifest.feedback.get(name, {})})


def _teacher(manifest: Manifest, name: str) -> Layer:
    return Layer(
        f"{manifest.path} [teacher.{name}]", {"teacher": {**TEACHERS.get(name, {}), **manifest.teachers.get(name, {})}}
    )


@cache
def _profile_settings(scale: str, task: str, kind: ProfileKind) -> tuple[tuple[Layer, Flat], ...]:
    return tuple((layer, flatten(layer)) for layer in profiles()[scale].layers(TASKS[task].suite, task, kind))


@cache
def _ratios(scale: str, task: str, kind: ProfileKind) -> dict[str, tuple[int, int]]:
    """For each amount (the profile's number, the paper's number); their quotient scales a manifest's."""
    ours, paper = _amounts(scale, task, kind), _amounts(PAPER, task, kind)
    total = (ours["steps"], paper["steps"])
    return {name: (ours[name], paper[name]) if paper[name] else total for name in AMOUNTS}


def _amounts(scale: str, task: str, kind: ProfileKind) -> dict[str, int]:
    values: Flat = {"steps": 1}  # a task of which no profile knows the length is not scaled
    for room, model in (
        ("feedback", FeedbackConfig()),
        ("exploration", ExplorationConfig()),
        ("evaluation", EvaluationConfig()),
        *((f"reward.{name}", section) for name, section in RewardConfig.own().items()),
        ("imitation", ImitationConfig()),
    ):
        values |= {f"{room}.{name}": value for name, value in model.model_dump().items()}
    for _, settings in _profile_settings(scale, task, kind):
        values |= settings
    return {name: values[name] for name in AMOUNTS}


def _scaled(layer: Layer, ratios: Mapping[str, tuple[int, int]], scale: str) -> Checked:
    written = flatten(layer)
    shrunk = {name: _shrunk(value, *ratios[name]) if name in ratios else value for name, value in written.items()}
    changed = {name: f"{written[name]!r}, {shrunk[name]!r} in profile {scale},"
               for name in shrunk if shrunk[name] != written[name]}  # fmt: skip
    return Checked(layer.where, shrunk, changed)


def _shrunk(value: int, ours: int, paper: int) -> int:
    """`value * ours / paper` to the nearest integer; what was not zero stays so."""
    return max((2 * value * ours + paper) // (2 * paper), min(value, 1))
