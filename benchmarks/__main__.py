"""All benchmarks, one table: `python -m benchmarks [NAME ...]`, or `make bench`.

A benchmark is a module of this folder with a function `lines()` and an entry below. Peers come with the extra `bench`;
where one is not installed its column stays empty.
"""

from __future__ import annotations

import argparse
import importlib
import json
import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from rich.console import Console
from rich.table import Table

from benchmarks.lines import Line
from rrm.hardware import cpu_model

#: In the order of the table; everything runs on one core unless its module says otherwise.
BENCHMARKS = (
    "sac_update",
    "drqv2_update",
    "reward_learning",
    "training_loop",
    "images",
    "bootstrap",
    "perception",
    "rig",
    "commands",
    "labelling",
    "sweep",
    "cluster",
    "cards",
)


def table(lines: Sequence[Line]) -> Table:
    """The lines, with what was asked of each and whether it holds."""
    out = Table("item", "ours", "peers", "best", "ratio", "floor", "share", "asked", "met", title=cpu_model())
    for line in lines:
        out.add_row(
            f"{line.item} [dim]{line.note}[/]" if line.note else line.item,
            f"{line.ours:.4g} {line.unit}",
            "\n".join(f"{figure:.4g} {line.unit} ({peer})" for peer, figure in line.peers.items()),
            line.best,
            "" if line.ratio is None else f"{line.ratio:.3g}",
            "" if line.floor is None else f"{line.floor:.4g} {line.unit}",
            "" if line.share is None else f"{line.share:.0%}",
            line.demand,
            {True: "yes", False: "[bold red]no[/]", None: ""}[line.met],
        )
    return out


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"which: {', '.join(BENCHMARKS)} (default: all)")
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    args = parser.parse_args()
    unknown = sorted(set(args.names) - set(BENCHMARKS))
    if unknown:
        parser.error(f"there is no benchmark {', '.join(unknown)}; there are {', '.join(BENCHMARKS)}")
    lines: list[Line] = []
    for name in args.names or BENCHMARKS:
        print(f"{name} ...", file=sys.stderr, flush=True)
        for line in importlib.import_module(f"benchmarks.{name}").lines():
            print(f"  {line.item}: {line.ours:.4g} {line.unit}", file=sys.stderr, flush=True)
            lines.append(line)
    Console(width=None if sys.stdout.isatty() else 160).print(table(lines))
    if args.json:
        args.json.write_text(
            json.dumps([asdict(line) | {"best": line.best, "met": line.met} for line in lines], indent=1) + "\n"
        )


if __name__ == "__main__":
    main()
