"""An experiment as a TOML file: which runs there are, which figure they make, and how it is read.

A manifest is a grid (tasks x methods x teachers x feedback schedules x seeds) plus what differs from the defaults. Only
its structure is checked here; whether its settings make runs that can be run is for `rrmctl.planning.plan` to say. The
format is described in docs/manifests.md; every key is a field below.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    StrictInt,
    StringConstraints,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_validator,
)
from pydantic_core import ErrorDetails

from rrmctl.errors import UserError, check_known, shown
from rrmctl.planning.toml import read_toml

#: Settings of a run, as nested tables with the keys of `rrm.training.run_config.RunConfig`.
Settings = dict[str, Any]

Axis = Literal["tasks", "methods", "teachers", "feedback"]
Text = Annotated[str, StringConstraints(strict=True, min_length=1, strip_whitespace=True)]

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

    @model_validator(mode="after")
    def _says_something(self) -> GridRows:
        if not self.model_fields_set:
            raise ValueError("an empty entry matches every row; name a task or a method")
        return self

    @property
    def given(self) -> dict[str, str]:
        """The names that are given."""
        return self.model_dump(include={*GridRows.model_fields}, exclude_none=True)

    def __str__(self) -> str:
        return "{" + ", ".join(f'{key} = "{name}"' for key, name in self.given.items()) + "}"


class Include(GridRows):
    """Rows beside those of the grid; an axis that is not named takes all of the grid's values."""

    set: Settings = {}  #: settings of these rows alone


class Grid(_Frozen):
    """Axes that are crossed with one another."""

    tasks: Names
    methods: Names
    teachers: Names = (DEFAULT_TEACHER,)
    feedback: Names = (DEFAULT_FEEDBACK,)  #: names of [feedback.NAME] sections
    zip: tuple[Annotated[tuple[Axis, ...], Field(min_length=2)], ...] = ()  #: axes that advance together
    include: tuple[Include, ...] = ()
    exclude: tuple[GridRows, ...] = ()
    set: Settings = {}  #: settings of every row of this grid

    @field_validator("tasks", "methods", "teachers", "feedback", "zip")
    @classmethod
    def _distinct(cls, names: tuple[Any, ...], info: ValidationInfo) -> tuple[Any, ...]:
        paired = info.field_name == "zip"
        times = Counter(chain(*names) if paired else names)
        if twice := sorted(name for name in times if times[name] > 1):
            problem = "an axis can be paired once only" if paired else "named twice"
            raise ValueError(f"{problem}: {', '.join(twice[:5])}")
        return names


class MethodTable(_Frozen, extra="allow"):
    """A method of the manifest's own, or settings of a known one: whatever is neither learner nor prior."""

    learner: Text | None = None  #: a learner's name, `true`, `prior`, or `file.py:Class`
    prior: Text | None = None  #: a prior's name, or `file.py:function`

    @property
    def settings(self) -> Settings:
        """Of its runs."""
        return self.model_extra or {}


class Manifest(_Frozen):
    """One experiment. Settings are at the paper's scale; `rrmctl.planning.plan` says how profiles scale them."""

    name: str  #: the file's stem
    path: Path  #: where it was read from
    title: Text
    reproduces: Annotated[tuple[Text, ...], Field(min_length=1)]  #: figures and tables of the paper, or what it is for
    rule: Text  #: one sentence: what is reported, and at which step
    closing: Text | None = None  #: how to read what comes out: said by `run` once all is there
    default_profile: Text = "paper"  #: the scale when none is asked for
    seeds: StrictInt | tuple[StrictInt, ...] = 10  #: a number of seeds from 0 up, or a list of them
    grids: Annotated[
        tuple[Grid, ...],
        BeforeValidator(lambda grid: grid if isinstance(grid, list) else [grid]),
        Field(alias="grid", min_length=1),
    ]
    defaults: Settings = {}  #: settings of every run
    tasks: Sections = Field({}, alias="task")  #: [task.NAME]
    methods: dict[_Key, MethodTable] = Field({}, alias="method")  #: [method.NAME]
    teachers: Sections = Field({}, alias="teacher")  #: [teacher.NAME]: keys of `TeacherConfig`
    feedback: Sections = {}  #: [feedback.NAME]: keys of `FeedbackConfig`
    profiles: Sections = Field({}, alias="profile")  #: [profile.NAME]: taken as they stand, not scaled


_KEYS = {described.alias or name for name, described in Manifest.model_fields.items()} - {"name", "path"}


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
    for key in table:
        check_known(key, sorted(_KEYS), f'{path}: unknown key "{key}"', "known keys")
    if "grid" not in table:
        raise UserError(f"{path}: there is no [grid]", "add [grid] with tasks = [...] and methods = [...]")
    try:
        return Manifest.model_validate({**table, "name": path.stem, "path": path})
    except ValidationError as error:
        mistakes = error.errors(include_url=False)
    several = isinstance(table["grid"], list)
    for *place, wrong in (mistake["loc"] for mistake in mistakes if mistake["type"] == "extra_forbidden"):
        model = Include if "include" in place else GridRows if "exclude" in place else Grid
        where = " ".join([f"[[grid]] {int(place[1]) + 1}" if several else "[grid]", *map(str, place[2:3])])
        check_known(str(wrong), sorted(model.model_fields), f'{path} {where}: unknown key "{wrong}"', "known keys")
    raise UserError("\n".join(_explained(mistakes, path, table.get("seeds"))))


def _explained(mistakes: Sequence[ErrorDetails], path: Path, seeds: Any) -> dict[str, None]:
    """What pydantic found, in one line per mistake: file, key, what is wrong, what was given."""
    lines = []
    inside = {mistake["loc"][:depth] for mistake in mistakes for depth in range(len(mistake["loc"]))}
    for mistake in [mistake for mistake in mistakes if mistake["loc"] not in inside][:5]:  # the innermost say it all
        top, *rest = map(str, mistake["loc"])
        key = f"[grid] {'.'.join(rest[1:])}".rstrip() if top == "grid" and rest else ".".join([top, *rest])
        key = key.removesuffix(".[key]")  # of a name that is no name
        given = shown(mistake["input"])
        if top == "seeds":  # one line for the number and the list that were tried
            lines.append(f"{path}: seeds: expected a number or a list of integers; got {shown(seeds)}")
        elif mistake["type"] == "missing":
            lines.append(f"{path}: {key} is missing")
        elif mistake["type"] == "too_short":
            least = mistake["ctx"]["min_length"]
            lines.append(f"{path}: {key} is {'empty' if least == 1 else 'too short'}; name at least {least}")
        elif mistake["type"] in ("model_type", "dict_type"):
            lines.append(f"{path}: {key}: expected a table; got {given}")
        else:
            problem = mistake["msg"].removeprefix("Value error, ").replace("tuple", "list")
            lines.append(f"{path}: {key}: {problem}; got {given}")
    return dict.fromkeys(lines)
