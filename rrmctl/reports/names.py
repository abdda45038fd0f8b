"""Names that people ask for, and what to say where nothing is called so."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from rrm.errors import nearest
from rrmctl.commands import rrmctl
from rrmctl.errors import UserError, check_known
from rrmctl.store.layout import Layout


def experiments(layout: Layout, asked: Sequence[str]) -> list[str]:
    """The experiments that are asked for, each once; all of the store where none is.

    Raises:
        UserError: the store holds no run of one, or none at all.
    """
    known = layout.experiments()
    if not known:
        raise UserError(
            f"{layout.root} holds no experiment yet",
            f"start one, e.g. `{rrmctl('run', 'quickstart', results=layout.root)}`",
        )
    for name in asked:
        if name not in known:
            near = nearest(name, known)
            start = "" if near else "; `rrmctl list` names what there is to run"
            raise UserError(f'{layout.root} holds no runs of "{name}"{near}', f"it holds: {', '.join(known)}{start}")
    return list(dict.fromkeys(asked)) or known


def check_profile(profile: str | None, present: Iterable[str]) -> None:
    """Refuse a profile of which there are no runs; None asks for none.

    Raises:
        UserError: with the nearest that there is.
    """
    known = sorted(set(present))
    if profile is not None:
        check_known(profile, known, f'no runs of profile "{profile}"', "there are runs of")
