"""Options that several commands share, spelled once. Nothing heavy is imported here."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path
from typing import Annotated

import typer

from rrm.files import place
from rrmctl.commands import DEFAULT_RESULTS as DEFAULT_RESULTS  # noqa: PLC0414 (for the commands)
from rrmctl.errors import UserError

# For the shell, which picks those that start with what was typed.


def _experiments() -> list[str]:
    from rrmctl.planning.experiments import available

    folder = os.environ.get("RRMCTL_EXPERIMENTS")
    with contextlib.suppress(UserError):  # no such folder
        return list(available(place(folder) if folder else None))
    return []


def _profiles() -> list[str]:
    from rrmctl.planning.profiles import profiles

    return list(profiles())


def _settings() -> list[str]:
    from rrmctl.planning.settings import known_settings

    return [f"{name}=" for name in known_settings()]


ExperimentArgument = Annotated[str, typer.Argument(
    metavar="NAME", autocompletion=_experiments,
    help="An experiment of `rrmctl list`, or the path of a manifest of your own.",
)]  # fmt: skip
ResultsOption = Annotated[
    Path, typer.Option(parser=place, metavar="DIR", envvar="RRMCTL_RESULTS", help="Where runs are kept.")
]
ExperimentsOption = Annotated[Path | None, typer.Option(
    parser=place, metavar="DIR", envvar="RRMCTL_EXPERIMENTS",
    help="Where manifests of your own are, beside those of rrmctl. Default: experiments.",
)]  # fmt: skip
ScaleOption = Annotated[str | None, typer.Option(
    autocompletion=_profiles,
    help="Scale: paper, bpref, bpref-dmc, laptop, quickstart or smoke. Default: the manifest's, mostly paper.",
)]  # fmt: skip
SeedsOption = Annotated[
    str | None, typer.Option(metavar="N|LIST", help="10 means seeds 0 to 9; 0,3,7 means these; 4, means seed 4 alone.")
]
TasksOption = Annotated[list[str] | None, typer.Option(metavar="A,B", help="Only these tasks of the experiment.")]
MethodsOption = Annotated[list[str] | None, typer.Option(metavar="A,B", help="Only these methods of the experiment.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON for programs instead of a table.")]
SetOption = Annotated[list[str] | None, typer.Option(
    "--set", metavar="KEY=VALUE", autocompletion=_settings,
    help="Change a setting of every run, e.g. agent.batch=256. Repeatable.",
)]  # fmt: skip
PriorOption = Annotated[list[str] | None, typer.Option(
    metavar="NAME|FILE.py:FUNCTION", help="Add the residual method on this prior to the experiment. Repeatable.",
)]  # fmt: skip
#: Silence after which a job counts as hung, minutes; a feedback session may take some.
HANG_AFTER_MIN = 30.0

WorkersOption = Annotated[
    int | None,
    typer.Option("--workers", "-j", min=1, help="Jobs at a time, one core each. Default: every core there is."),
]
MemoryOption = Annotated[float | None, typer.Option(
    min=0.1, metavar="GIB", help="A job that takes more is ended and goes on from its checkpoint.",
)]  # fmt: skip
HangOption = Annotated[float, typer.Option(
    min=0.01, metavar="MINUTES",
    help="A job that shows no progress for so long is ended and goes on from its checkpoint.",
)]  # fmt: skip
ExecutorOption = Annotated[str, typer.Option(
    metavar="local|slurm|ray",
    help="Who runs the jobs: processes here, job arrays that are submitted to Slurm, or the nodes of a Ray cluster.",
)]  # fmt: skip
SlurmOption = Annotated[list[str] | None, typer.Option(
    "--slurm", metavar="FLAG", help="A flag of sbatch as it stands, e.g. --slurm=--account=x. Repeatable.",
)]  # fmt: skip
AtOnceOption = Annotated[int | None, typer.Option(
    min=1, metavar="N", help="With slurm: tasks of an array at a time; with ray: runs at a time. Default: all.",
)]  # fmt: skip
AddressOption = Annotated[str | None, typer.Option(
    metavar="HOST:PORT",
    help="With ray: the cluster's. Default: RAY_ADDRESS, else a cluster of this machine alone, while it lasts.",
)]  # fmt: skip
DeviceOption = Annotated[str | None, typer.Option(
    metavar="cpu|cuda|cuda:N|auto",
    help="Where networks learn: --set device=... in short. cuda:1 is that card alone; auto is a card if there is one.",
)]  # fmt: skip
GpusOption = Annotated[str | None, typer.Option(
    metavar="N,N|SHARE",
    help="Here: the cards that runs may use, by CUDA's numbers, e.g. 0,1; default: all. With ray: of a card, for each "
    "run on one, e.g. 0.25; default: 1.",
)]  # fmt: skip
PerGpuOption = Annotated[int | None, typer.Option(
    "--per-gpu", min=1, metavar="N",
    help="Runs at a time on each card. Default: as many as `rrmctl doctor --tune` found to pay, else 1.",
)]  # fmt: skip
MpsOption = Annotated[bool, typer.Option(
    "--mps", help="Have NVIDIA's MPS daemon, started for this command, let runs share a card's work. Off by default.",
)]  # fmt: skip
PackOption = Annotated[
    int | None, typer.Option(min=1, metavar="K", help="With slurm: runs of a task, for short ones. Default: 1.")
]
RetryOption = Annotated[bool, typer.Option("--retry-failed", help="Try failed runs again, from their checkpoint.")]
UntilDecidedOption = Annotated[
    bool,
    typer.Option("--until-decided", help="Run seeds in groups until it is decided which methods differ; see above."),
]
MaxSeedsOption = Annotated[
    int | None, typer.Option(min=1, metavar="N", help="With --until-decided: seeds 0 to N-1 at most.")
]
GroupOption = Annotated[
    int | None, typer.Option(min=2, max=8, help="With --until-decided: seeds between two looks. Default: 5.")
]
AgainstOption = Annotated[
    str | None, typer.Option(metavar="METHOD", help="With --until-decided: compare with this. Default: the first.")
]


def split_names(values: list[str] | None) -> list[str] | None:
    """`["a,b", "c"]` as typed on the command line becomes `["a", "b", "c"]`; None stays None."""
    return values if values is None else [name.strip() for value in values for name in value.split(",") if name.strip()]
