"""Layers of settings become one checked `RunConfig`, and every mistake is traced to the layer it came from."""

from __future__ import annotations

import json
import re
import types
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Annotated, Any, Union, get_args, get_origin

from pydantic import BaseModel, TypeAdapter, ValidationError
from pydantic.fields import FieldInfo

from rrm.config import RewardConfig
from rrm.errors import RrmError, nearest
from rrm.toml import NestingError, loads
from rrm.training.run_config import CONFIG_VERSION, RunConfig
from rrmctl.errors import UserError, shown
from rrmctl.planning.manifest import Settings
from rrmctl.planning.profiles import Layer
from rrmctl.planning.toml import refuse_odd

#: Settings that say how long, how often and how much: the ones a profile shrinks in a manifest's numbers.
AMOUNTS = (
    "steps",
    "feedback.every", "feedback.batch", "feedback.budget", "feedback.segment",
    "exploration.seed_steps", "exploration.unsupervised_steps",
    "evaluation.every",
    *(f"reward.{name}.{amount}" for name, section in RewardConfig.own().items() for amount in section.amounts),
    "imitation.steps", "imitation.seed_steps", "imitation.every", "imitation.window", "imitation.switch",
)  # fmt: skip

#: Larger integers do not survive JSON and parquet.
_LARGEST = 2**53

#: Text that needs no quotes after --set: a word, or the path of a file.
_BARE = re.compile(r"[\w-]+|[\w~./-]*[/.][A-Za-z][\w./-]*")

#: So much of an assignment is repeated in a message.
_LONGEST = 200

#: Settings that something else decides, and what does.
_DECIDED = {
    "task": "the grid's tasks or --tasks",
    "seed": "the manifest's seeds or --seeds",
    "profile": "--profile",
    "reward.learner": "the method ([method.NAME] learner = ...)",
    "reward.prior": "the method ([method.NAME] prior = ...) or --prior",
    "reward.learner_digest": "planning, from the file's content",
    "reward.prior_digest": "planning, from the file's content",
    "reward.prior_run": "planning, from the settings in imitation",
    "imitation.demos_digest": "planning, from the file's content",
    "imitation.demos_run": "planning, from the settings in imitation",
}


def known_settings() -> list[str]:
    """Dotted names of everything a layer may set."""
    return [name for name in _fields() if name not in _DECIDED]


@cache
def _fields() -> dict[str, TypeAdapter[Any]]:
    """A checker for every leaf of `RunConfig`, by dotted name."""
    return dict(_leaves(RunConfig, ""))


@cache
def _sections() -> dict[str, str]:
    """Sections of `RunConfig`, each with the first setting in it that a layer may set."""
    return {name.rpartition(".")[0]: name for name in reversed(known_settings()) if "." in name}


def _leaves(model: type[BaseModel], prefix: str) -> Iterator[tuple[str, TypeAdapter[Any]]]:
    for name, described in model.model_fields.items():
        inner = _section(described)
        if inner is not None:
            yield from _leaves(inner, f"{prefix}{name}.")
        else:
            checked: Any = Annotated[described.annotation, described]  # the type with its bounds
            yield f"{prefix}{name}", TypeAdapter(checked)


def _section(field: FieldInfo) -> type[BaseModel] | None:
    """The model of a nested section, `Section` or `Section | None`; None for a leaf."""
    optional = get_origin(field.annotation) in (Union, types.UnionType)
    kinds = get_args(field.annotation) if optional else (field.annotation,)
    return next((kind for kind in kinds if isinstance(kind, type) and issubclass(kind, BaseModel)), None)


def flatten(layer: Layer) -> dict[str, Any]:
    """The layer's settings by dotted name, each checked for name and type.

    Raises:
        UserError: unknown key, wrong type, or a setting that is decided elsewhere; the message names layer and key.
    """
    return {key: _checked(key, value, layer.where) for key, value in _walk(layer.settings, "", layer.where)}


def _walk(tree: Any, prefix: str, where: str) -> Iterator[tuple[str, Any]]:
    if not isinstance(tree, dict):
        raise UserError(f"{where}: {prefix.rstrip('.') or 'the section'} must be a table, got {shown(tree)}")
    for key, value in tree.items():
        name = f"{prefix}{key}"
        if name in _sections():
            yield from _walk(value, f"{name}.", where)
        elif name in _fields():
            yield name, value
        else:
            raise UserError(
                f'{where}: unknown key "{name}"{suggestion(name)}', "keys are those of RunConfig, e.g. agent.batch"
            )


def suggestion(name: str) -> str:
    """The nearest known setting: by its whole dotted name, or by its last part alone."""
    last = name.rpartition(".")[2]
    same = [known for known in known_settings() if known.rpartition(".")[2] == last]
    return f'; did you mean "{same[0]}"?' if same else nearest(name, known_settings())


def _checked(name: str, value: Any, where: str) -> Any:
    if name in _DECIDED:
        raise UserError(f"{where}: {name} cannot be set here; it follows from {_DECIDED[name]}")
    if isinstance(value, int) and abs(value) > _LARGEST:
        raise UserError(f"{where}: {name} = {value} is too large")
    adapter = _fields()[name]
    try:
        checked = adapter.validate_python(value, strict=True)
    except ValidationError as error:
        if isinstance(value, float) and value.is_integer():  # 1e5 is how people write 100000
            return _checked(name, int(value), where)
        found = error.errors(include_url=False)[0]
        raise UserError(f"{where}: {name} = {shown(value)}: {found['msg']}") from None
    try:
        json.dumps(checked, allow_nan=False)
    except (TypeError, ValueError):
        raise UserError(f"{where}: {name} = {shown(value)}: only text, finite numbers, lists and tables") from None
    return checked


@dataclass(frozen=True)
class Checked:
    """A layer whose settings are checked."""

    where: str
    settings: Mapping[str, Any]  #: by dotted name
    written: Mapping[str, str] = field(default_factory=dict)  #: for messages: settings that are written otherwise


def resolve(layers: Iterable[Checked], cell: str, **decided: Any) -> RunConfig:
    """One configuration out of checked layers, later ones winning.

    Args:
        layers: widest first.
        cell: what is being configured, for messages: file, task and method.
        decided: settings by dotted name that no layer may change.

    Raises:
        UserError: the settings do not go together (a segment longer than an episode, feedback after the end); the
            message names the layer that the offending setting came from.
    """
    values: dict[str, Any] = {}
    origin: dict[str, str] = {}
    for layer in layers:
        values |= layer.settings
        origin |= {
            name: f"{name} = {layer.written.get(name, repr(value))} is set in {layer.where}"
            for name, value in layer.settings.items()
        }
    if "steps" not in values:
        raise UserError(
            f"{cell}: no profile says how many steps this task takes", "set steps in the manifest's [defaults]"
        )
    try:
        return RunConfig.model_validate(nested(values | decided))
    except ValidationError as error:
        found = error.errors(include_url=False)[0]
        reason = found.get("ctx", {}).get("error")
        message = str(reason) if isinstance(reason, RrmError) else f"{'.'.join(map(str, found['loc']))}: {found['msg']}"
    key = message.partition(":")[0]
    raise UserError(f"{cell}: {message}", origin.get(key))


def nested(flat: Mapping[str, Any]) -> Settings:
    """`{"agent.batch": 1}` becomes `{"agent": {"batch": 1}}`."""
    tree: Settings = {}
    for name, value in flat.items():
        *rooms, leaf = name.split(".")
        at = tree
        for room in rooms:
            at = at.setdefault(room, {})
        at[leaf] = value
    return tree


def config_version() -> int:
    """Of the configurations that this program trains."""
    return CONFIG_VERSION


def parse_assignments(assignments: Iterable[str]) -> dict[str, Any]:
    """`--set` arguments, `key=value` with a TOML value, by dotted name; a bare word is text.

    Raises:
        UserError: not an assignment, an unknown key, a wrong type.
    """
    settings: dict[str, Any] = {}
    for text in assignments:
        key, equals, value = text.partition("=")
        where = f"--set {text[:_LONGEST]}{'...' * (len(text) > _LONGEST)}"
        if not equals or not key.strip():
            raise UserError(f"{where}: expected KEY=VALUE, e.g. --set agent.batch=256")
        settings[key.strip()] = _value(value.strip(), where)
    refuse_odd(settings, "--set")
    return check_assignments(settings)


def check_assignments(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Overrides by dotted name, each checked. Raises `UserError` as `parse_assignments` does."""
    for name, value in settings.items():
        if name in _sections():
            inside = value if isinstance(value, dict) else ()
            named = [f"{name}.{key}" for key in inside if f"{name}.{key}" in _fields()]
            example = next(iter(named), _sections()[name])
            raise UserError(
                f"--set {name}: {name} is a section; write {example}=...", "one --set for each setting in it"
            )
        if name not in _fields():
            raise UserError(
                f'--set {name}: unknown setting "{name}"{suggestion(name)}', "rrmctl plan --help shows examples"
            )
    return {name: _checked(name, value, "--set") for name, value in settings.items()}


def _value(text: str, where: str) -> Any:
    try:
        table = loads(f"value = {text}")
    except NestingError as error:
        raise UserError(f"{where}: {error}") from None
    except ValueError:
        table = {}
    if table.keys() == {"value"}:
        return table["value"]
    if _BARE.fullmatch(text):
        return text
    raise UserError(f"{where}: not a TOML value", 'numbers, true, false, "text", [1, 2]')
