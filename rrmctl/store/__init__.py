"""The store: every run's configuration, provenance, curve and state, as plain JSON and parquet files.

For notebooks: `from rrmctl.store import load` and `load("results")` is every evaluation as a tidy DataFrame.
"""

from rrmctl.store.gradients import load_gradients
from rrmctl.store.reader import load, planned

__all__ = ["load", "load_gradients", "planned"]
