"""An experiment as a TOML file: which runs there are, which figure they make, and how it is read.

A manifest is a grid (tasks x methods x teachers x feedback schedules x seeds) plus what differs from the defaults. Only
its structure is checked here; whether its settings make runs that can be run is for `rrmctl.planning.plan` to say. The
format is described in docs/manifests.md; every key is a field below.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    StrictInt,
    StringConstraints,
    ValidationError,
    field_validator,
)

from rrmctl.errors import UserError, check_known, shown
from rrmctl.planning.toml import read_toml

#: Settings of a run, as nested tables with the keys of `rrm.training.run_config.RunConfig`.
Settings = dict[str, Any]

Axis = Literal["tasks", "methods", "teachers", "feedback"]
Text = Annotated[str, StringConstraints(strict=True, min_length=1, strip_whitespace=True)]
Texts = Annotated[tuple[Text, ...], Field(min_length=1)]

_NAME = re.compile(r"\w([\w .+@-]{0,98}[\w.+@-])?")


def _plain(name: str) -> str:
    """A name that tables, file systems and command lines leave as it is."""
    if not _NAME.fullmatch(name):
        raise ValueError("a name is made of letters, digits and inner spaces or . _ + @ -, at most 100 in all")
    return name


Name = Annotated[Text, AfterValidator(_plain)]
Names = Annotated[tuple[Name, ...], Field(min_length=1)]
_Key = Annotated[str, AfterValidator(_plain)]  # two keys that differ in spaces alone must not become one
Sections = dict[_Key, Settings]

#: The teacher and the schedule of feedback that need no name in a manifest.
DEFAULT_TEACHER = "oracle"
DEFAULT_FEEDBACK = "default"

_EXPERIMENT_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,127}")  # it becomes a file's in the store


class _Frozen(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class GridRows(_Frozen):
    """Some rows of a grid: those that agree with every name given here."""

    task: Name | None = None
    method: Name | None = None
    teacher: Name | None = None
    feedback: Name | None = None


class Include(GridRows):
    """Rows beside those of the grid; an axis that is not named takes all of the grid's values."""

    set: Settings = Field(default_factory=dict)  #: settings of these rows alone


class Grid(_Frozen):
    """Axes that are crossed with one another."""

    tasks: Names
    methods: Names
    teachers: Names = (DEFAULT_TEACHER,)
    feedback: Names = (DEFAULT_FEEDBACK,)  #: names of [feedback.NAME] sections
    zip: tuple[Annotated[tuple[Axis, ...], Field(min_length=2)], ...] = ()  #: axes that advance together
    include: tuple[Include, ...] = ()
    exclude: tuple[GridRows, ...] = ()
    set: Settings = Field(default_factory=dict)  #: settings of every row of this grid

    @field_validator("tasks", "methods", "teachers", "feedback")
    @classmethod
    def _distinct(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        twice = sorted(name for name, times in Counter(names).items() if times > 1)
        if twice:
            raise ValueError(f"named twice: {', '.join(twice[:5])}")
        return names

    @field_validator("zip")
    @classmethod
    def _paired_once(cls, groups: tuple[tuple[str, ...], ...]) -> tuple[tuple[str, ...], ...]:
        axes = [axis for group in groups for axis in group]
        twice = sorted(axis for axis, times in Counter(axes).items() if times > 1)
        if twice:
            raise ValueError(f"an axis can be paired once only: {', '.join(twice)}")
        return groups


class MethodTable(_Frozen):
    """A method of the manifest's own, or settings of a known one."""

    learner: Text | None = None  #: a learner's name, `true`, `prior`, or `file.py:Class`
    prior: Text | None = None  #: a prior's name, or `file.py:function`
    settings: Settings = Field(default_factory=dict)


class Manifest(_Frozen):
    """One experiment. Settings are at the paper's scale; `rrmctl.planning.plan` says how profiles scale them."""

    name: str  #: the file's stem
    path: Path  #: where it was read from
    title: Text
    reproduces: Texts  #: figures and tables of the paper, or what else it is for
    rule: Text  #: one sentence: what is reported, and at which step
    closing: Text | None = None  #: how to read what comes out: said by `run` once all is there
    default_profile: Text = "paper"  #: the scale when none is asked for
    seeds: StrictInt | tuple[StrictInt, ...] = 10  #: a number of seeds from 0 up, or a list of them
    grids: Annotated[tuple[Grid, ...], Field(min_length=1)]
    defaults: Settings = Field(default_factory=dict)  #: settings of every run
    tasks: Sections = Field(default_factory=dict)  #: [task.NAME]
    methods: dict[_Key, MethodTable] = Field(default_factory=dict)  #: [method.NAME]
    teachers: Sections = Field(default_factory=dict)  #: [teacher.NAME]: keys of `TeacherConfig`
    feedback: Sections = Field(default_factory=dict)  #: [feedback.NAME]: keys of `FeedbackConfig`
    profiles: Sections = Field(default_factory=dict)  #: [profile.NAME]: taken as they stand, not scaled


#: Keys and sections of a manifest, and the fields they fill where the two differ.
_SECTIONS = {"task": "tasks", "method": "methods", "teacher": "teachers", "profile": "profiles", "grid": "grids"}
_KEYS = {"title", "reproduces", "rule", "closing", "default_profile", "seeds", "defaults", "feedback", *_SECTIONS}


def refuse_unknown(table: Mapping[str, Any], known: Iterable[str], where: str) -> None:
    """Raise `UserError` for the first key of `table` that is not known, with the nearest one that is."""
    for key in table:
        check_known(key, sorted(known), f'{where}: unknown key "{key}"', "known keys")


def load(path: Path) -> Manifest:
    """Read and check one manifest.

    Raises:
        UserError: unreadable file, unknown key, wrong type, empty list; the message names file and key.
    """
    if not _EXPERIMENT_NAME.fullmatch(path.stem):
        raise UserError(
            f"{path}: an experiment's name is made of letters, digits, - and _, at most 128 in all", "rename the file"
        )
    return parse(read_toml(path), path)


def parse(table: Mapping[str, Any], path: Path) -> Manifest:
    """The manifest that `table`, read from `path`, describes. Raises `UserError` as `load` does."""
    refuse_unknown(table, _KEYS, str(path))
    fields = {_SECTIONS.get(key, key): value for key, value in table.items()}
    grid = table.get("grid")
    if grid is None:
        raise UserError(f"{path}: there is no [grid]", "add [grid] with tasks = [...] and methods = [...]")
    fields["grids"] = grid if isinstance(grid, list) else [grid]
    for number, entry in enumerate(fields["grids"], start=1):
        _check_grid(entry, f"{path} [[grid]] {number}" if isinstance(grid, list) else f"{path} [grid]")
    if isinstance(fields.get("methods"), dict):
        fields["methods"] = {name: _split_method(entry) for name, entry in fields["methods"].items()}
    try:
        return Manifest(name=path.stem, path=path, **fields)
    except ValidationError as error:
        raise UserError(_explain(error, path, table.get("seeds"))) from None


def _check_grid(grid: Any, where: str) -> None:
    if not isinstance(grid, dict):
        raise UserError(f"{where}: expected a table with tasks and methods, got {shown(grid)}")
    refuse_unknown(grid, Grid.model_fields, where)
    for key, model in (("include", Include), ("exclude", GridRows)):
        rows = grid.get(key, [])
        if isinstance(rows, list):
            for row in rows:
                if isinstance(row, dict):
                    refuse_unknown(row, model.model_fields, f"{where} {key}")
                    if not row:
                        raise UserError(f"{where} {key}: an empty entry matches every row; name a task or a method")


def _split_method(entry: Any) -> Any:
    """`learner` and `prior` say what the method is; everything else in its section is settings."""
    if not isinstance(entry, dict):
        return entry
    named = {key: entry[key] for key in ("learner", "prior") if key in entry}
    return named | {"settings": {key: value for key, value in entry.items() if key not in named}}


_SPELLED = {field: key for key, field in _SECTIONS.items()}


def _explain(error: ValidationError, path: Path, seeds: Any) -> str:
    """What pydantic found, in one line per mistake: file, key, what is wrong, what was given."""
    lines = []
    mistakes = error.errors(include_url=False)
    inside = {found["loc"][:depth] for found in mistakes for depth in range(len(found["loc"]))}
    for found in [found for found in mistakes if found["loc"] not in inside][:5]:  # the innermost say it all
        if found["loc"][0] == "seeds":  # one line for the number and the list that were tried
            lines.append(f"{path}: seeds: expected a number or a list of integers; got {shown(seeds)}")
            continue
        key = _key([str(part) for part in found["loc"]])
        if found["type"] == "missing":
            lines.append(f"{path}: {key} is missing")
        elif found["type"] == "too_short":
            least = found["ctx"]["min_length"]
            lines.append(f"{path}: {key} is {'empty' if least == 1 else 'too short'}; name at least {least}")
        else:
            what = found["msg"].removeprefix("Value error, ").replace("tuple", "list")
            lines.append(f"{path}: {key}: {what}; got {shown(found['input'])}")
    return "\n".join(dict.fromkeys(lines))


def _key(location: list[str]) -> str:
    """The key as a person wrote it: pydantic adds the numbers of list entries and the kinds it tried."""
    top, *rest = location
    if top == "grids" and rest:
        return f"[grid] {'.'.join(rest[1:])}"
    kinds = ("settings", "[key]", "int", "tuple[int, ...]")
    return ".".join([_SPELLED.get(top, top), *(part for part in rest if part not in kinds)])
