"""Norms of gradients that runs left beside their curves."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rrm.files import read_bounded
from rrmctl.store.curve import LARGEST, rerunning
from rrmctl.store.files import DamagedError, unreadable
from rrmctl.store.frame import NUMBER, TEXT, WHOLE, frame, typed
from rrmctl.store.layout import RunFolder
from rrmctl.store.reader import new_results

if TYPE_CHECKING:
    import pandas as pd

_KINDS = {"run": TEXT, "step": WHOLE, "loss": TEXT, "gradient_norm": NUMBER}
_COLUMNS = tuple(_KINDS)[1:]


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

    folders = (new_results(results).run(run) for run in dict.fromkeys(runs))
    frames = [_read(folder) for folder in folders if folder.gradients.is_file()]
    return pd.concat([frame([], _KINDS), *frames], ignore_index=True)


def _read(folder: RunFolder) -> pd.DataFrame:
    import pyarrow as pa
    import pyarrow.parquet as pq

    hint = f"remove the file, or train the run again: {rerunning(folder)}"
    try:
        data = read_bounded(folder.gradients, LARGEST)
    except OSError as error:
        raise unreadable(folder.gradients, error) from error
    try:
        file = pq.ParquetFile(pa.BufferReader(data), page_checksum_verification=True)
        norms: pd.DataFrame = file.read(use_threads=False).to_pandas(use_threads=False)
        if tuple(norms.columns) != _COLUMNS:
            raise ValueError(f"its columns are {', '.join(norms.columns)}")
        return typed(norms.assign(run=folder.id)[list(_KINDS)], _KINDS)
    except (pa.ArrowException, OSError, ValueError, TypeError) as error:
        raise DamagedError(f"{folder.gradients} is damaged: {error}", hint) from error
