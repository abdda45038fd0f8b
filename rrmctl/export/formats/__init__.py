"""The formats: each module here is a value of `rrmctl export --to`.

A module has

- a docstring, whose first line `rrmctl export --help` shows, and
- `write(bundle, folder) -> list[Path]`, which writes the runs below a folder and says where. Writing the same again
  leaves the same: nothing is there twice. It raises a StorageError where the folder takes no write, a UserError where
  a package is missing.
"""

from rrmctl.reports.plugins import Entry, entries


def formats() -> dict[str, Entry]:
    """The formats, by name."""
    return entries(__file__, __name__)
