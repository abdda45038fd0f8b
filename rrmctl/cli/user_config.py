"""What a user wants everywhere: `rrmctl/config.toml` in `$XDG_CONFIG_HOME` or `~/.config`.

[slurm]
flags = ["--account=x", "--partition=gpu"]
setup = "module load cuda"
at_once = 20
pack = 4

[ray]
address = "head:6379"
gpus = 0.25
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from rrmctl.errors import UserError, check_known, shown

if TYPE_CHECKING:
    from rrmctl.running.slurm_arrays import Site


def _file() -> Path | None:
    """None where nobody has a home."""
    named = os.environ.get("XDG_CONFIG_HOME")
    try:
        return (Path(named) if named else Path.home() / ".config") / "rrmctl" / "config.toml"
    except RuntimeError:
        return None


_Fits = tuple[str, Callable[[Any], bool]]

_TEXT: _Fits = ("text", lambda value: type(value) is str)
_TEXTS: _Fits = (
    "a list of texts",
    lambda value: isinstance(value, list) and all(type(word) is str for word in value),
)
_COUNT: _Fits = ("a whole number above 0", lambda value: type(value) is int and value > 0)
_SHARE: _Fits = (
    "a number from 0.0001",  # below that Ray does not divide
    lambda value: type(value) in (int, float) and 0.0001 <= value < math.inf,
)

#: The tables, and what each key of theirs wants.
_TABLES: dict[str, dict[str, _Fits]] = {
    "slurm": {"flags": _TEXTS, "setup": _TEXT, "at_once": _COUNT, "pack": _COUNT},
    "ray": {"address": _TEXT, "gpus": _SHARE, "at_once": _COUNT},
}


def slurm_site(flags: Sequence[str], at_once: int | None, pack: int | None) -> Site:
    """The table [slurm] of the user's file, and what was typed, which wins. UserError where the file is wrong."""
    from rrmctl.running.slurm_arrays import Site

    table = _table("slurm", at_once=at_once, pack=pack)
    return Site(**{**table, "flags": (*table.get("flags", ()), *flags)})


class RaySite(NamedTuple):
    """How a user runs on Ray: see docs/cluster.md."""

    address: str | None = None  #: of the cluster; None: one of this machine alone
    gpus: float = 1.0  #: share of a card for each run on one
    at_once: int | None = None  #: runs at a time; None: as many as Ray has room for


def ray_site(address: str | None, gpus: float | None, at_once: int | None) -> RaySite:
    """The same of [ray]; where neither names an address, RAY_ADDRESS may."""
    wanted, fitting = _SHARE
    if gpus is not None and not fitting(gpus):
        raise UserError(f"--gpus is {gpus:g}, not {wanted}")
    site = RaySite(**_table("ray", address=address, gpus=gpus, at_once=at_once))
    return site._replace(address=site.address or os.environ.get("RAY_ADDRESS") or None)


def _table(name: str, **typed: object) -> dict[str, Any]:
    """A table of the file, with what was typed in its place."""
    from rrmctl.planning.toml import read_toml

    path = _file()
    content = read_toml(path) if path is not None and path.exists() else {}
    for found in content:
        check_known(found, _TABLES, f"{path}: unknown table [{found}]", "known tables")
    table = content.get(name, {})
    if not isinstance(table, dict):
        raise UserError(f"{path}: {name} is {shown(table)}, not a table")
    for key, value in table.items():
        check_known(key, _TABLES[name], f'{path}: unknown key "{key}" in [{name}]', "known keys")
        wanted, fitting = _TABLES[name][key]
        if not fitting(value):
            raise UserError(f"{path}: {name}.{key} is {shown(value)}, not {wanted}")
    return table | {key: value for key, value in typed.items() if value is not None}
