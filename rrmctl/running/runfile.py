"""`config.json`: a run's configuration on its way from the plan to the worker."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rrmctl.errors import UserError
from rrmctl.store.layout import RunFolder
from rrmctl.store.reader import read_config

if TYPE_CHECKING:
    from rrm.training.config import RunConfig

#: Keys beside those of the configuration.
_LABELS = ("id", "cell", "method", "config_version")


def config_content(config: RunConfig) -> dict[str, Any]:
    """What `config.json` holds; `load_config` is the inverse."""
    from rrm.training.config import CONFIG_VERSION

    config = config.canonical()
    labels = (config.identity, config.cell, config.method, CONFIG_VERSION)
    return dict(zip(_LABELS, labels, strict=True)) | config.model_dump(mode="json")


def load_config(folder: RunFolder) -> RunConfig:
    """The run's configuration, checked against its id and against the user's files it names.

    Raises:
        UserError, RrmError: the file is missing, damaged or of another version, or a file it names has changed.
    """
    from pydantic import ValidationError

    from rrm.training.config import CONFIG_VERSION, RunConfig

    stored = read_config(folder)
    if stored.get("config_version") != CONFIG_VERSION:
        raise UserError(
            f"{folder.config} is of configuration version {stored.get('config_version')}, "
            f"this program trains version {CONFIG_VERSION}",
            "use the rrmctl that wrote it, or run the experiment into another --results folder",
        )
    try:
        config = RunConfig.model_validate({key: value for key, value in stored.items() if key not in _LABELS})
    except ValidationError as error:
        raise UserError(f"{folder.config} is not a configuration: {error}", "move it away and run again") from error
    _check_files(config)
    if config.identity != folder.id:
        raise UserError(
            f"{folder.config} describes run {config.identity}, not {folder.id}: it was edited",
            "move the run's folder away and run the experiment again",
        )
    return config


def _check_files(config: RunConfig) -> None:
    """Refuse a user's file that is no longer the one the run was planned with: it would be another run."""
    from rrm.registry import source_digest

    reward = config.reward
    for name, planned in ((reward.prior, reward.prior_digest), (reward.learner, reward.learner_digest)):
        if name is not None and source_digest(name) != planned:
            raise UserError(
                f"{name.rpartition(':')[0]} has changed since this run was planned with it",
                "run the experiment again: the changed file makes new runs; or bring the old file back, then "
                "`rrmctl resume --retry-failed`",
            )
