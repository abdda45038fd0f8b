"""The columns of the store's parquet files, and their version.

`curve.parquet` holds one row per evaluation: what the run is, every field of `rrm.types.EvalRow` (a test compares), and
a column of float64 for each of its figures, by the name that the run's agent or source of rewards gives it.
The version stands in the file's metadata under `rrmctl.schema_version`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterable

    import pyarrow as pa

#: Raised by one whenever a column is added, removed, or changes its meaning.
SCHEMA_VERSION = 1

#: Key of the version in a parquet file's metadata.
VERSION_KEY = b"rrmctl.schema_version"

#: Key of the checksum over all values.
CHECKSUM_KEY = b"rrmctl.crc32"

#: What a row belongs to, with arrow types.
IDENTITY = {
    "run": "string",  # the run's identity, sixteen hex digits
    "cell": "string",  # the identity of all seeds together
    "profile": "string",
    "task": "string",
    "method": "string",
    "seed": "int64",
}

#: What an evaluation measured; units as in `rrm.types.EvalRow`.
MEASURED = {
    "step": "int64",
    "episodes": "int64",
    "true_return": "float64",
    "success": "float64",
    "queries": "int64",
    "labels": "int64",
    "prior_mean": "float64",
    "residual_mean": "float64",
    "reward_mean": "float64",
    "reward_std": "float64",
    "true_reward_mean": "float64",
    "wall_s": "float64",
    "steps_per_s": "float64",
}

#: Measured columns that depend on the machine and its load; two equal runs differ in these alone.
TIMINGS = ("wall_s", "steps_per_s")

#: Labels of a sweep record, which `load` joins to the curve.
LABELS = ("experiment", "variant", "profile", "task", "method", "teacher", "feedback", "seed")


def curve_schema(figures: Iterable[str] = ()) -> pa.Schema:
    """The schema of a `curve.parquet` with these figures, version included."""
    import pyarrow as pa

    columns = IDENTITY | MEASURED | dict.fromkeys(figures, "float64")
    fields: list[Any] = [pa.field(name, kind, nullable=False) for name, kind in columns.items()]
    return pa.schema(fields, metadata={VERSION_KEY: str(SCHEMA_VERSION).encode()})
