"""One row of a grid becomes the configuration of its runs: layers of settings, scaled to the profile.

Settings, widest first: the library's defaults, the profile (by suite, task and kind of method), then the manifest's
[defaults], the grid's `set`, [task.NAME], [feedback.NAME], the teacher, [method.NAME], an include's `set`,
[profile.NAME], and `--set` last.

A manifest's amounts (steps, feedback, seed steps ...) are written at the paper's scale. In another profile they shrink
as that profile's own number for the task does: `every = 20_000` on a task whose paper schedule is 5000 means four
times whatever the profile asks. [profile.NAME] and `--set` are taken as they stand.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any, get_args

from rrm.config import RewardConfig
from rrm.envs.tasks import TASKS
from rrm.teachers import TEACHERS
from rrm.training.run_config import RunConfig
from rrmctl.errors import check_known
from rrmctl.labels import NOTHING_ASKED
from rrmctl.planning.grid import GridRow
from rrmctl.planning.manifest import DEFAULT_FEEDBACK, Manifest
from rrmctl.planning.methods import TASK, Method
from rrmctl.planning.profiles import PAPER, PATH, ProfileKind, profiles
from rrmctl.planning.schedules import Schedule
from rrmctl.planning.settings import Layer, fields, merged, resolve

#: Settings that say how long, how often and how much: the ones a profile shrinks in a manifest's numbers.
AMOUNTS = (
    "steps",
    "feedback.every", "feedback.batch", "feedback.budget", "feedback.segment",
    "exploration.seed_steps", "exploration.unsupervised_steps",
    "evaluation.every",
    *(f"reward.{name}.{amount}" for name, section in RewardConfig.own().items() for amount in section.amounts),
    "imitation.steps", "imitation.seed_steps", "imitation.every", "imitation.window", "imitation.switch",
)  # fmt: skip

#: Kinds of section by name, and the fields of a manifest that hold them.
_FIELDS = {"task": "tasks", "profile": "profiles", "teacher": "teachers", "feedback": "feedback"}

#: What a label of feedback spells out; a schedule that sets anything else is named in it.
_SPELLED = {"batch", "every", "budget"}


def check_names(manifest: Manifest, row: GridRow) -> None:
    """Refuse a task, teacher or schedule of feedback that nothing defines."""
    for kind, name, known in (
        ("task", row.task, TASKS),
        ("teacher", row.teacher, {**TEACHERS, **manifest.teachers}),
        ("feedback schedule", row.feedback, {DEFAULT_FEEDBACK, *manifest.feedback}),
    ):
        check_known(name, sorted(known), f'{manifest.path}: unknown {kind} "{name}"')


def check_sections(manifest: Manifest) -> None:
    """Check every setting of the manifest, also of sections and profiles that a plan does not use."""
    for kind, field in _FIELDS.items():
        for name in getattr(manifest, field):
            _layer(manifest, kind, name)
    for name in manifest.profiles:
        check_known(name, profiles(), f"{manifest.path} [profile.{name}]: no profile has this name")


def configure(manifest: Manifest, row: GridRow, method: Method, scale: str, overrides: Mapping[str, Any]) -> RunConfig:
    """The configuration of the row's runs, with seed 0, in the profile `scale` and with overrides of `--set`.

    Raises:
        UserError: unknown key, wrong type, or settings that cannot be run together; names file, section and key.
    """
    decided = {"task": row.task, "seed": 0, "profile": scale, "reward.learner": method.learner}
    if method.prior is not None:
        decided["reward.prior"] = method.prior.replace(TASK, row.task)
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
            layers += [Layer.read(f"{where}]", common), Layer.read(f"{where}.{kind}]", settings.get(kind, {}))]
    return tuple(layers)


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
    defaults = {name: fields()[name].default for name in AMOUNTS}
    defaults["steps"] = 1  # a task of which no profile knows the length is not scaled
    ours, paper = (defaults | merged(profile_layers(name, task, kind)) for name in (scale, PAPER))
    total = (ours["steps"], paper["steps"])
    return {name: (ours[name], paper[name]) if paper[name] else total for name in AMOUNTS}


def _scaled(layer: Layer, ratios: Mapping[str, tuple[int, int]], scale: str) -> Layer:
    shrunk = {}
    for name in layer.settings.keys() & ratios.keys():
        value, (ours, paper) = layer.settings[name], ratios[name]
        # To the nearest integer; what was not zero stays so.
        shrunk[name] = max((2 * value * ours + paper) // (2 * paper), min(value, 1))
    written = {name: f"{layer.settings[name]!r}, {value!r} in profile {scale},"
               for name, value in shrunk.items() if value != layer.settings[name]}  # fmt: skip
    return Layer(layer.where, {**layer.settings, **shrunk}, written)
