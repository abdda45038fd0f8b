"""`config.json`: a run's configuration on its way from the plan to the worker."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from rrmctl.commands import rrmctl
from rrmctl.errors import UserError
from rrmctl.store.layout import RunFolder
from rrmctl.store.reader import read_config

if TYPE_CHECKING:
    from rrm.training.config import RunConfig
    from rrm.training.demos import DemosConfig

#: Keys beside those of the configuration.
_LABELS = ("id", "cell", "method", "config_version", "kind", "steps")


def config_content(config: RunConfig | DemosConfig) -> dict[str, Any]:
    """What `config.json` holds; `load_config` is the inverse."""
    from rrm.training.config import CONFIG_VERSION

    config = config.canonical()
    labels = (config.identity, config.cell, config.method, CONFIG_VERSION, config.kind, config.steps)
    return dict(zip(_LABELS, labels, strict=True)) | config.model_dump(mode="json")


def load_config(folder: RunFolder) -> RunConfig | DemosConfig:
    """The run's configuration, checked against its id and against the user's files it names.

    Raises:
        UserError, RrmError: the file is missing, damaged or of another version, or a file it names has changed.
    """
    from pydantic import ValidationError

    from rrm.training.config import CONFIG_VERSION, RunConfig
    from rrm.training.demos import DemosConfig

    stored = read_config(folder)
    if stored.get("config_version") != CONFIG_VERSION:
        raise UserError(
            f"{folder.config} is of configuration version {stored.get('config_version')}, "
            f"this program trains version {CONFIG_VERSION}",
            "use the rrmctl that wrote it, or run the experiment into another --results folder",
        )
    model = DemosConfig if stored.get("kind") == "demos" else RunConfig  # written before there were kinds: a run
    fields = {key: value for key, value in stored.items() if key not in _LABELS or key in model.model_fields}
    try:
        config = model.model_validate(fields)
    except ValidationError as error:
        raise UserError(
            f"{folder.config} is not a configuration: {error}",
            "move it away and run the experiment again with --retry-failed",
        ) from error
    if isinstance(config, RunConfig):
        _check_files(config, folder)
    if config.identity != folder.id:
        raise UserError(
            f"{folder.config} describes run {config.identity}, not {folder.id}: it was edited",
            "move the run's folder away and run the experiment again",
        )
    return config


def _check_files(config: RunConfig, folder: RunFolder) -> None:
    """Refuse a user's file that is no longer the one the run was planned with: it would be another run."""
    from rrm.registry import file_digest, source_digest

    reward, demos = config.reward, config.imitation.demos
    named = [(reward.prior, reward.prior_digest), (reward.learner, reward.learner_digest)]
    found = [(name.rpartition(":")[0], source_digest(name), planned) for name, planned in named if name is not None]
    if demos is not None:
        found.append((demos, file_digest(Path(demos), "imitation.demos"), config.imitation.demos_digest))
    for path, digest, planned in found:
        if digest != planned:
            raise UserError(
                f"{path} has changed since this run was planned with it",
                "run the experiment again: the changed file makes new runs; or bring the old file back, then "
                f"`{rrmctl('resume', '--retry-failed', results=folder.results)}`",
            )
