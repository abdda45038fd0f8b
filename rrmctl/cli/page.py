"""`rrmctl report html`: everything the store tells, as one page."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from rrm.files import place
from rrmctl.cli.options import DEFAULT_RESULTS, ResultsOption
from rrmctl.cli.report import IqmKindOption, IqmOption, MixedOption, ProfileOption, ReplicatesOption
from rrmctl.cli.screen import tell
from rrmctl.errors import UserError


def html(
    names: Annotated[
        list[str] | None,
        typer.Argument(metavar="[NAME]...", help="Experiments of the store. Default: all."),
    ] = None,
    output: Annotated[
        Path,
        typer.Option(
            "-o", "--output", parser=place, metavar="FILE", help="The page; its folder is made where it is missing."
        ),
    ] = Path("report.html"),
    results: ResultsOption = DEFAULT_RESULTS,
    kind: IqmOption = IqmKindOption.RLIABLE,
    profile: ProfileOption = None,
    replicates: ReplicatesOption = 10_000,
    allow_mixed: MixedOption = False,
) -> None:
    """One page with everything: tables, figures, runs, failures, cost, settings, versions, commands.

    The file needs no other and no network. Figures enlarge, tables sort, and
    it prints. Runs under way and failed ones are on it, as such.
    """
    from rrmctl.reports.page.assembly import build
    from rrmctl.reports.statistics import Statistics
    from rrmctl.store.files import StorageError, write_bytes

    chosen = [Path(name).stem if name.endswith(".toml") else name for name in names or ()]
    settings = Statistics(kind=kind.value, replicates=replicates)
    page = build(results, chosen, profile=profile, settings=settings, allow_mixed=allow_mixed)
    data = page.encode()
    try:
        write_bytes(output, data)
    except StorageError as error:
        raise UserError(str(error), "name another place with -o") from error
    tell(f"{output}: {len(data) / 1e6:.1f} MB")
