"""The store: every run's configuration, provenance, curve and state, as plain JSON and parquet files.

For notebooks: `from rrmctl.store import load` and `load("results")` is every evaluation as a tidy DataFrame.

What reads a file raises DamagedError where it does not hold what it should, VersionError where another version of the
program wrote it, and StorageError where it cannot be read now. What writes raises StorageError where the folder takes
no write, and leaves what was there.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rrmctl.store.curve import load_gradients
    from rrmctl.store.snapshot import load, planned

__all__ = ["load", "load_gradients", "planned"]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from rrmctl.store import curve, snapshot  # with Pydantic, which the command line does without

    return getattr(curve if name == "load_gradients" else snapshot, name)
