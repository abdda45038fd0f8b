"""Packages that only one format needs."""

from __future__ import annotations

from importlib import metadata

from rrmctl.errors import UserError


def require(package: str) -> None:
    """Refuse to go on without an optional package; the extra that installs it has its name.

    Asks the installation rather than importing: a folder of that name in the working directory can be imported, too.

    Raises:
        UserError: it is not installed.
    """
    try:
        metadata.version(package)
    except metadata.PackageNotFoundError:
        raise UserError(f"this needs {package}, which is not installed", f"pip install 'rrmctl[{package}]'") from None
