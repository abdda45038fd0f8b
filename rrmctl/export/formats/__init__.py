"""The formats: each module here is a value of `rrmctl export --to`.

A module has

- a docstring, whose first line `rrmctl export --help` shows, and
- `write(bundle, folder) -> list[Path]`, which writes the runs below a folder and says where. Writing the same again
  leaves the same: nothing is there twice. It raises a StorageError where the folder takes no write, a UserError where
  a package is missing.
"""

from importlib import metadata

from rrmctl.errors import UserError
from rrmctl.reports.plugins import Entry, entries


def formats() -> dict[str, Entry]:
    """The formats, by name."""
    return entries(__file__, __name__)


def require(package: str) -> None:
    """Refuse to go on without a package that one format needs; the extra that installs it has its name.

    Asks the installation rather than importing: a folder of that name in the working directory can be imported, too.
    """
    try:
        metadata.version(package)
    except metadata.PackageNotFoundError:
        raise UserError(f"this needs {package}, which is not installed", f"pip install 'rrmctl[{package}]'") from None
