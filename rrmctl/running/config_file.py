"""`config.json`: a run's configuration on its way from the plan to the worker."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rrmctl.errors import UserError
from rrmctl.store.files import DamagedError
from rrmctl.store.layout import RunFolder
from rrmctl.store.provenance import CONFIG_HINT, read_config

if TYPE_CHECKING:
    from rrm.training.run_config import JobConfig, RunConfig

_BACK = (
    "bring it back, then `rrmctl resume` goes on; or run the experiment again with the file where it is now: the same "
    "content is the same run, a changed one makes new runs"
)


class MissingFileError(UserError):
    """A file of the user's that a run was planned with is not there now: no fault of the run's."""


#: Keys beside those of the configuration.
_LABELS = ("id", "cell", "method", "config_version", "kind", "steps")

#: Settings that name files of the user's without code.
_DATA = ("demos", "labels")


def config_content(config: JobConfig) -> dict[str, Any]:
    """What `config.json` holds; `load_config` is the inverse."""
    from rrm.training.run_config import CONFIG_VERSION

    config = config.canonical()
    labels = (config.identity, config.cell, config.method, CONFIG_VERSION, config.kind, config.steps)
    return dict(zip(_LABELS, labels, strict=True)) | config.model_dump(mode="json")


def load_config(folder: RunFolder) -> JobConfig:
    """The run's configuration, checked against its id and against the user's files it names.

    Raises MissingFileError where one of those is not there now, or is another one by now.
    """
    from pydantic import ValidationError

    from rrm.errors import ConfigError, LabelError, UnknownNameError
    from rrm.registry import file_digest
    from rrm.teachers.labels import answers_digest
    from rrm.training.kinds import JOBS
    from rrm.training.run_config import CONFIG_VERSION

    stored = read_config(folder)
    if stored.get("config_version") != CONFIG_VERSION:
        raise UserError(
            f"{folder.config} is of configuration version {stored.get('config_version')}, "
            f"this program trains version {CONFIG_VERSION}",
            "use the rrmctl that wrote it, or run the experiment into another --results folder",
        )
    for key, path, planned in _user_files(stored):  # another content would be another run
        try:
            changed = (answers_digest(Path(path)) if key == "labels" else file_digest(Path(path), key)) != planned
        except (ConfigError, LabelError) as error:
            raise MissingFileError(str(error), _BACK) from error
        if changed:
            raise MissingFileError(f"{path} has changed since this run was planned with it", _BACK)
    kind = str(stored.get("kind", "train"))  # written before there were kinds: a run
    if kind not in JOBS:
        raise DamagedError(f"{folder.config}: {UnknownNameError('kind of job', kind, JOBS)}", CONFIG_HINT)
    model = JOBS[kind].config
    fields = {key: value for key, value in stored.items() if key not in _LABELS or key in model.model_fields}
    try:
        config: JobConfig = model.model_validate(fields)
    except ValidationError as error:
        raise DamagedError(f"{folder.config} is not a configuration: {error}", CONFIG_HINT) from error
    if config.identity != folder.id:
        why = f"describes run {config.identity}, not {folder.id}: it was edited, or an earlier version wrote it"
        raise DamagedError(f"{folder.config} {why}", CONFIG_HINT)
    return config


def load_run(folder: RunFolder) -> RunConfig:
    """`load_config` of a run that trains a policy; a UserError where it does something else."""
    from rrm.training.run_config import RunConfig

    config = load_config(folder)
    if not isinstance(config, RunConfig):
        raise UserError(
            f"run {folder.id} ({config.task}, {config.method}) trains no policy",
            f"whose policy plays there: {', '.join(config.requires)}",
        )
    return config


def needs_opengl(folder: RunFolder, stored: Mapping[str, Any]) -> bool:
    """Whether the run of this configuration, as it is stored, needs OpenGL. Raises as `load_config`."""
    from rrm.envs.tasks import TASKS

    task = TASKS.get(str(stored.get("task")))
    return task is not None and task.needs_opengl and load_config(folder).needs_opengl


def on_card(folder: RunFolder) -> bool:
    """Whether the run is trained on a graphics card; not where its configuration cannot be read."""
    with contextlib.suppress(UserError):  # the run's own worker refuses it with this message
        return bool(read_config(folder).get("device") == "cuda")
    return False


def code_files(stored: Mapping[str, Any]) -> dict[str, str]:
    """The digests of the files with code that a run of this configuration would run, by path.

    Frozen language priors are none of them: such code can do nothing but compute.
    """
    from rrm.registry import LANGUAGE

    named = ((path, str(digest)) for key, path, digest in _user_files(stored) if key not in _DATA)
    return {path: digest for path, digest in named if not path.endswith(LANGUAGE)}


def _user_files(stored: Mapping[str, Any]) -> Iterator[tuple[str, str, Any]]:
    """Setting, path and planned digest of each file of the user's that a configuration names."""
    from rrm.registry import is_file_reference

    settings_of = (("reward", "prior"), ("reward", "learner"), ("imitation", "demos"), ("teacher", "labels"))
    policy = stored.get("policy")  # of a deployment
    for config, (section, key) in product((stored, policy) if isinstance(policy, dict) else (stored,), settings_of):
        settings = config.get(section) or {}
        name = settings.get(key) if isinstance(settings, dict) else None
        if isinstance(name, str) and (key in _DATA or is_file_reference(name)):
            yield key, name if key in _DATA else name.rpartition(":")[0], settings.get(f"{key}_digest")
