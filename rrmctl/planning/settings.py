"""Layers of settings become one checked `RunConfig`, and every mistake is traced to the layer it came from."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Annotated, Any, Self, Union, get_args, get_origin

from pydantic import BaseModel, ConfigDict, TypeAdapter, ValidationError
from pydantic.fields import FieldInfo

from rrm.errors import RrmError, nearest
from rrm.toml import NestingError, loads
from rrm.training.run_config import CONFIG_VERSION as CONFIG_VERSION  # noqa: PLC0414 (for reports, which know no rrm)
from rrm.training.run_config import RunConfig
from rrmctl.errors import UserError, check_known, shown
from rrmctl.planning.toml import refuse_odd

#: Larger integers do not survive JSON and parquet.
_LARGEST = 2**53

_AGENT = "agent."
_KIND = f"{_AGENT}kind"

_DEPLOY = "deploy."
_RIG = f"{_DEPLOY}rig."

#: Text that needs no quotes after --set: a word, a word and a number (cuda:1), or the path of a file.
_BARE = re.compile(r"[\w-]+|[a-z]+:\d+|[\w~./-]*[/.][A-Za-z][\w./-]*")

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
    "agent.encoder_run": "planning, from the settings in imitation",
    "imitation.demos_digest": "planning, from the file's content",
    "teacher.labels_digest": "planning, from the file's content",
    "imitation.demos_run": "planning, from the settings in imitation",
}


@cache
def fields() -> dict[str, tuple[FieldInfo, ...]]:
    """Every setting of a `RunConfig`, by dotted name; several where sections of several kinds have one so named."""

    def leaves(model: type[BaseModel], prefix: str) -> Iterator[tuple[str, FieldInfo]]:
        for name, described in model.model_fields.items():
            sections = _classes(described.annotation)
            if not sections:
                yield f"{prefix}{name}", described
            for section in sections:
                yield from leaves(section, f"{prefix}{name}.")

    named: dict[str, tuple[FieldInfo, ...]] = {}
    for name, described in leaves(RunConfig, ""):
        named[name] = (*named.get(name, ()), described)
    return named


def _classes(annotation: Any) -> list[type[BaseModel]]:
    """The sections that a field may hold: one, one or None, or one of several kinds; none where it is a setting."""
    if isinstance(annotation, type):
        return [annotation] if issubclass(annotation, BaseModel) else []
    if get_origin(annotation) is Annotated:
        return _classes(get_args(annotation)[0])
    return [section for part in get_args(annotation) for section in _classes(part)]


def known_settings() -> list[str]:
    """Dotted names of everything a layer may set."""
    return [name for name in fields() if name not in _DECIDED]


@cache
def _sections() -> dict[str, str]:
    """Sections of `RunConfig`, each with the first setting in it that a layer may set."""
    return {name.rpartition(".")[0]: name for name in reversed(known_settings()) if "." in name}


@cache
def _checker(name: str) -> TypeAdapter[Any]:
    """Of a setting's type, with its bounds."""
    kinds = {str(described): Annotated[described.annotation, described] for described in fields()[name]}
    checked: Any = Union[tuple(kinds.values())]  # noqa: UP007  (of so many as there are)
    return TypeAdapter(checked, config=ConfigDict(strict=True))


@dataclass(frozen=True)
class Layer:
    """Settings, checked one by one, and the place they were read from, which errors name."""

    where: str
    settings: Mapping[str, Any] = field(hash=False)  #: by dotted name
    written: Mapping[str, str] = field(default_factory=dict, hash=False)  #: as messages show what is written otherwise
    usual: bool = False  #: of what is not asked for by name: what another kind of agent has not is passed over

    @classmethod
    def read(cls, where: str, tree: Any, *, usual: bool = False) -> Self:
        """The layer of a tree of tables; an unknown key, a wrong type or what is decided elsewhere is refused."""
        return cls(where, {name: _checked(name, value, where) for name, value in _walk(tree, "", where)}, usual=usual)

    def of_agent(self, kind: str) -> Self:
        """Without what this kind of agent has not, where that is not asked for by name."""
        if not self.usual or not any(name.startswith(_AGENT) for name in self.settings):
            return self
        own = {f"{_AGENT}{name}" for name in _agents()[kind].model_fields}
        left = {name: value for name, value in self.settings.items() if not name.startswith(_AGENT) or name in own}
        return replace(self, settings=left)


@cache
def _agents() -> dict[str, type[BaseModel]]:
    """The sections of agents, by kind."""
    return {
        get_args(s.model_fields["kind"].annotation)[0]: s for s in _classes(RunConfig.model_fields["agent"].annotation)
    }


def _walk(tree: Any, prefix: str, where: str) -> Iterator[tuple[str, Any]]:
    if not isinstance(tree, dict):
        raise UserError(f"{where}: {prefix.rstrip('.') or 'the section'} must be a table, got {shown(tree)}")
    for key, value in tree.items():
        name = f"{prefix}{key}"
        if name in _sections():
            yield from _walk(value, f"{name}.", where)
        elif name in fields():
            yield name, value
        else:
            raise UserError(
                f'{where}: unknown key "{name}"{_suggestion(name)}', "keys are those of RunConfig, e.g. agent.batch"
            )


def _suggestion(name: str) -> str:
    """The nearest known setting: by its whole dotted name, or by its last part alone."""
    same = [setting for setting in known_settings() if setting.rpartition(".")[2] == name.rpartition(".")[2]]
    return f'; did you mean "{same[0]}"?' if same else nearest(name, known_settings())


def _checked(name: str, value: Any, where: str) -> Any:
    if name in _DECIDED:
        raise UserError(f"{where}: {name} cannot be set here; it follows from {_DECIDED[name]}")
    if isinstance(value, int) and abs(value) > _LARGEST:
        raise UserError(f"{where}: {name} = {value} is too large")
    try:
        checked = _checker(name).validate_python(value)
        json.dumps(checked, allow_nan=False)
    except ValidationError as error:
        if isinstance(value, float) and value.is_integer():  # 1e5 is how people write 100000
            return _checked(name, int(value), where)
        reasons = dict.fromkeys(mistake["msg"] for mistake in error.errors(include_url=False))
        raise UserError(f"{where}: {name} = {shown(value)}: {'; '.join(reasons)}") from None
    except (TypeError, ValueError):
        raise UserError(f"{where}: {name} = {shown(value)}: only text, finite numbers, lists and tables") from None
    return checked


def merged(layers: Iterable[Layer]) -> dict[str, Any]:
    """The settings of all layers, later ones winning."""
    return {name: value for layer in layers for name, value in layer.settings.items()}


def resolve(layers: Sequence[Layer], cell: str, **decided: Any) -> RunConfig:
    """The configuration of a cell (for messages: file, task and method), later layers winning, `decided` over all.

    Settings that do not go together (a segment longer than an episode, feedback after the end) are refused; the hint
    names the layer that the offending one came from.
    """
    kind = (merged(layers) | decided).get(_KIND, "sac")
    layers = [layer.of_agent(kind) for layer in layers]
    values, origin = merged(layers), {name: layer for layer in layers for name in layer.settings}
    if "steps" not in values:
        raise UserError(
            f"{cell}: no profile says how many steps this task takes", "set steps in the manifest's [defaults]"
        )
    tree: dict[str, Any] = {}
    for name, value in (values | decided).items():
        *sections, leaf = name.split(".")
        table = tree
        for section in sections:
            table = table.setdefault(section, {})
        table[leaf] = value
    try:
        return RunConfig.model_validate(tree)
    except ValidationError as error:
        mistake = error.errors(include_url=False)[0]
    reason = mistake.get("ctx", {}).get("error")
    message = str(reason) if isinstance(reason, RrmError) else _located(mistake["loc"], mistake["msg"])
    name = message.partition(":")[0]
    hint = None
    if (source := origin.get(name)) is not None:
        hint = f"{name} = {source.written.get(name, repr(values[name]))} is set in {source.where}"
    raise UserError(f"{cell}: {message}", hint)


def _located(place: Sequence[int | str], reason: str) -> str:
    """What is wrong with which setting. Pydantic names the kind of a section that has several, between it and those."""
    name = ".".join(map(str, place))
    if name in fields():
        return f"{name}: {reason}"
    section, kind, *rest = map(str, place)
    return f"{section}.{'.'.join(rest)}: {reason}; the {section} is {kind}"


def parse_assignments(assignments: Iterable[str]) -> dict[str, Any]:
    """`--set` arguments, `key=value` with a TOML value, by dotted name and checked; a bare word is text."""
    settings: dict[str, Any] = {}
    for text in assignments:
        key, equals, value = text.partition("=")
        where = f"--set {text[:_LONGEST]}{'...' * (len(text) > _LONGEST)}"
        if not equals or not key.strip():
            raise UserError(f"{where}: expected KEY=VALUE, e.g. --set agent.batch=256")
        settings[key.strip()] = _value(value.strip(), where)
    refuse_odd(settings, "--set")
    for name, value in settings.items():
        if name in _sections():
            inside = value if isinstance(value, dict) else ()
            example = next((f"{name}.{key}" for key in inside if f"{name}.{key}" in fields()), _sections()[name])
            raise UserError(
                f"--set {name}: {name} is a section; write {example}=...", "one --set for each setting in it"
            )
        if name not in fields():
            raise UserError(
                f'--set {name}: unknown setting "{name}"{_suggestion(name)}', "rrmctl plan --help shows examples"
            )
    return {name: _checked(name, value, "--set") for name, value in settings.items()}


def parse_rig(assignments: Iterable[str]) -> dict[str, Any]:
    """`--set` arguments of a deployment, `rig.KEY=VALUE`, by the key in `RigConfig` and checked."""
    given, known = list(assignments), [name.removeprefix(_DEPLOY) for name in fields() if name.startswith(_RIG)]
    for text in given:
        name = text.partition("=")[0].strip()
        check_known(name, known, f'--set {name[:_LONGEST]}: unknown setting "{name[:_LONGEST]}"', "a rig has")
        if "=" not in text:
            raise UserError(f"--set {name}: expected rig.KEY=VALUE, e.g. --set rig.blur=2")
    settings = parse_assignments(_DEPLOY + text.strip() for text in given)
    return {name.removeprefix(_RIG): value for name, value in settings.items()}


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
