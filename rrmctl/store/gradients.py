"""Norms of gradients that runs left beside their curves."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rrmctl.store.atomic import DamagedError, unreadable
from rrmctl.store.curve import rerunning
from rrmctl.store.layout import Layout, RunFolder

if TYPE_CHECKING:
    import pandas as pd

_COLUMNS = ("step", "loss", "gradient_norm")


def load_gradients(results: str | Path, runs: Sequence[str]) -> pd.DataFrame:
    """The norms of the gradients in the reward of these runs, at every gradient step.

    Args:
        results: the results root.
        runs: their ids; those that left no `gradients.parquet` are left out.

    Returns:
        Columns `run`, `step` (environment steps), `loss` (text) and `gradient_norm`.

    Raises:
        DamagedError: a file is damaged, or has other columns.
        StorageError: it cannot be read now.
    """
    import pandas as pd

    folders = (Layout(Path(results)).run(run) for run in dict.fromkeys(runs))
    frames = [_read(folder) for folder in folders if folder.gradients.is_file()]
    return pd.concat(frames, ignore_index=True) if frames else pd.DataFrame(columns=["run", *_COLUMNS])


def _read(folder: RunFolder) -> pd.DataFrame:
    import pyarrow as pa
    import pyarrow.parquet as pq

    hint = f"remove the file, or train the run again: {rerunning(folder)}"
    try:
        data = folder.gradients.read_bytes()
    except OSError as error:
        raise unreadable(folder.gradients, error) from error
    try:
        file = pq.ParquetFile(pa.BufferReader(data), page_checksum_verification=True)
        frame: pd.DataFrame = file.read().to_pandas()
    except (pa.ArrowException, OSError, ValueError) as error:
        raise DamagedError(f"{folder.gradients} is damaged: {error}", hint) from error
    if tuple(frame.columns) != _COLUMNS:
        raise DamagedError(f"{folder.gradients} is damaged: its columns are {', '.join(frame.columns)}", hint)
    return frame.astype({"loss": str}).assign(run=folder.id)[["run", *_COLUMNS]]
