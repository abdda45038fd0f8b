"""Names that people ask for, and what to say where nothing is called so."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from rrmctl.errors import check_known
from rrmctl.store.layout import Layout
from rrmctl.store.reader import never_run


def experiments(layout: Layout, asked: Sequence[str]) -> list[str]:
    """The experiments that are asked for, each once; all of the store where none is.

    Raises:
        UserError: the store holds no run of one, or none at all.
    """
    known = layout.experiments()
    unknown = [name for name in asked if name not in known]
    if unknown or not known:
        raise never_run(layout, *unknown)
    return list(dict.fromkeys(asked)) or known


def check_profile(profile: str | None, present: Iterable[str]) -> None:
    """Refuse a profile of which there are no runs; None asks for none.

    Raises:
        UserError: with the nearest that there is.
    """
    known = sorted(set(present))
    if profile is not None:
        check_known(profile, known, f'no runs of profile "{profile}"', "there are runs of")
