"""Which experiments there are: those that come with the program, and over them those of a folder of the user's."""

from __future__ import annotations

from pathlib import Path

from rrm.files import place
from rrmctl.errors import UserError, check_known

_BUILT = Path(__file__).resolve().parents[1] / "experiments"
#: The manifests that come with the program: in a built package within it, in the repository beside it.
SHIPPED = _BUILT if _BUILT.is_dir() else _BUILT.parents[1] / "experiments"
#: Where the user's are, in the working directory, unless they say otherwise.
OWN = Path("experiments")


def available(folder: Path | None) -> dict[str, Path]:
    """Every manifest by the experiment's name: the shipped ones, and before them those of the user's folder.

    A folder that is named must be there; None stands for `OWN`, which need not.
    """
    if folder is not None and not folder.is_dir():
        raise UserError(f"there is no folder {folder}", "name another with --experiments DIR or RRMCTL_EXPERIMENTS")
    paths = [*SHIPPED.glob("*.toml"), *(folder or OWN).glob("*.toml")]
    return dict(sorted({path.stem: path for path in paths}.items()))


def replaced(manifests: dict[str, Path]) -> list[str]:
    """Names of the shipped experiments in place of which another file stands."""
    return [
        name for name, path in manifests.items() if path.parent.resolve() != SHIPPED and (SHIPPED / path.name).exists()
    ]


def find(name: str, folder: Path | None) -> Path:
    """The manifest of the experiment `name` (the nearest is suggested), or `name` itself: the path of a .toml file."""
    path = place(name)
    if name.endswith(".toml") and not path.is_dir():
        if not path.exists():
            raise UserError(f"there is no file {name}")
        return path
    manifests = available(folder)
    if name and name not in manifests and path.is_dir():
        raise UserError(f"{name} is a folder", "name an experiment of `rrmctl list`, or one manifest (*.toml)")
    check_known(name, manifests, f'no experiment "{name}"')
    return manifests[name]
