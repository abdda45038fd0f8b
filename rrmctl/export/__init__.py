"""The store's content in the forms of other programs. Nothing heavy is imported before it is needed."""

from importlib import metadata

from rrmctl.errors import UserError


def require(package: str) -> None:
    """Refuse to go on without a package that one format needs; the extra that installs it has its name.

    Asks the installation rather than importing: a folder of that name in the working directory can be imported, too.
    """
    try:
        metadata.version(package)
    except metadata.PackageNotFoundError:
        raise UserError(f"this needs {package}, which is not installed", f"pip install 'rrmctl[{package}]'") from None
