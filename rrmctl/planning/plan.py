"""From a manifest to jobs: grid x seeds at one profile, each job with its whole configuration. Nothing is run here."""

from __future__ import annotations

import hashlib
import itertools
import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rrm.devices import kind_of
from rrm.errors import RrmError
from rrmctl.errors import UserError, check_known, shown
from rrmctl.labels import Label, deployed
from rrmctl.planning.grid import GridRow, check, configure, feedback_label, rows_of, teacher_label
from rrmctl.planning.manifest import Manifest
from rrmctl.planning.methods import Method, method, residual
from rrmctl.planning.prerequisites import FILES, Config, deployment_of, supply, taught
from rrmctl.planning.profiles import profiles
from rrmctl.planning.settings import parse_assignments
from rrmctl.store.sweeps import Job, SweepRecord

if TYPE_CHECKING:
    from rrm.robot.config import DeployConfig
    from rrm.training.run_config import RunConfig

_MOST_SEEDS = 10_000
_MOST_RUNS = 100_000  # some ten seconds of planning
_LARGEST_SEED = 2**32 - 1


@dataclass(frozen=True, kw_only=True)
class Plan(SweepRecord):
    """What one `run` command asks for: jobs seed by seed, so that every method has its first curve early.

    Jobs of equal configuration are one job; what is needed stands before those that need it.
    """

    configs: Mapping[str, Config]  #: of every run, by id
    manifest: Manifest


def make_plan(
    manifest: Manifest,
    *,
    profile: str | None = None,
    seeds: str | int | Sequence[int] | None = None,
    tasks: Sequence[str] | None = None,
    methods: Sequence[str] | None = None,
    overrides: Iterable[str] = (),
    priors: Sequence[str] = (),
) -> Plan:
    """The jobs of an experiment.

    Args:
        manifest: the experiment.
        profile: its scale; None is the manifest's own default.
        seeds: "10", "0,3,7", a number or a list; None is the manifest's.
        tasks, methods: only these, of those the manifest has.
        overrides: settings, `key=value` as typed after `--set`.
        priors: residual methods on these priors beside the manifest's methods: names, or `file.py:function` as seen
            from the folder the command runs in.

    Raises:
        UserError: an unknown name or key, a wrong type, or settings that cannot be run together.
    """
    where = "--profile" if profile is not None else f"{manifest.path}: default_profile"
    scale = manifest.default_profile if profile is None else profile
    check_known(scale, profiles(), f'{where}: unknown profile "{scale}"')
    settings = parse_assignments(overrides)
    if "device" in settings:  # which card of this machine is a matter of one command
        settings["device"] = kind_of(settings["device"])
    numbers = parse_seeds(manifest.seeds, f"{manifest.path}: seeds") if seeds is None else parse_seeds(seeds, "--seeds")
    rows = rows_of(manifest)
    own = {row.method: method(row.method, manifest) for row in rows}
    check(manifest, rows)
    rows = _only(rows, "task", tasks, manifest)
    added = _added(priors, own)
    beside = [replace(row, method=name) for row in rows for name in added]
    rows = list(dict.fromkeys([*_only(rows, "method", methods, manifest, added), *beside]))
    if (runs := len(rows) * len(numbers)) > _MOST_RUNS:
        raise UserError(
            f"{manifest.path}: {len(numbers):,} seeds of {len(rows):,} rows are {runs:,} runs; "
            f"a plan has at most {_MOST_RUNS:,}",
            "ask for fewer --seeds, or for some --tasks or --methods",
        )
    cells: list[tuple[Job, RunConfig, DeployConfig]] = []
    chains: dict[str, Config] = {}
    named: dict[Label, RunConfig] = {}
    for row in rows:
        job, config, needed, after = _cell(manifest, row, (own | added)[row.method], scale, settings)
        if named.setdefault(job.row, config) != config:  # no report could tell them apart
            raise UserError(
                f"{manifest.path}: two different runs are both called {' / '.join(job.row)}",
                "give one of them a method name of its own: [method.NAME] with learner and prior",
            )
        cells.append((job, config, after))
        chains |= {prerequisite.identity: prerequisite for prerequisite in needed}
    jobs: dict[str, Job] = {}
    configs: dict[str, Config] = {}
    deployments: dict[str, Job] = {}
    for seed, (job, config, after) in itertools.product(numbers, cells):
        seeded = config.model_copy(update={"seed": seed})
        run = seeded.identity
        if run not in jobs:
            try:
                seeded.check_answers()
            except RrmError as error:
                raise UserError(f"{manifest.path}: {error}") from None
            jobs[run], configs[run] = replace(job, id=run, seed=seed), seeded
            if after.checkpoints:
                deployment = deployment_of(seeded, after)
                deployments[deployment.identity] = _job(deployment, job.row._replace(method=deployed(job.method)))
                configs[deployment.identity] = deployment
    return Plan(
        experiment=manifest.name, profile=scale, overrides=settings, variant=variant(scale, settings),
        jobs=tuple(jobs.values()),
        needed=tuple(_job(config) for run, config in chains.items() if run not in jobs),
        deployments=tuple(deployments.values()),
        configs=chains | configs, manifest=manifest, priors=tuple(str(new.prior) for new in added.values()),
    )  # fmt: skip


def parse_seeds(given: str | int | Sequence[int], where: str) -> list[int]:
    """Seeds out of "10" (0 to 9), "0,3,7", "4," (seed 4 alone), a number, or a list.

    Raises:
        UserError: none, a duplicate, negative, too many, or not numbers.
    """
    hint = "10 means seeds 0 to 9; 0,3,7 means these three; 4, means seed 4 alone"
    if isinstance(given, str):
        parts = [part.strip() for part in given.split(",")]
        if parts[-1] == "" and len(parts) > 1:
            parts.pop()
        if not all(part.isascii() and part.removeprefix("-").isdigit() and len(part) < 20 for part in parts):
            raise UserError(f"{where} {shown(given)}: expected a number of seeds or a list of them", hint)
        given = [int(part) for part in parts] if "," in given else int(parts[0])
    if isinstance(given, int):
        if not 1 <= given <= _MOST_SEEDS:
            raise UserError(f"{where}: {given} seeds; any number from 1 to {_MOST_SEEDS} can be run", hint)
        return list(range(given))
    if not given:
        raise UserError(f"{where}: the list of seeds is empty", hint)
    if len(given) > _MOST_SEEDS:
        raise UserError(f"{where}: {len(given)} seeds; at most {_MOST_SEEDS} can be run", hint)
    wrong = [seed for seed in given if not 0 <= seed <= _LARGEST_SEED]
    if wrong:
        raise UserError(f"{where}: seed {wrong[0]}; seeds lie between 0 and {_LARGEST_SEED}", hint)
    seed, times = Counter(given).most_common(1)[0]
    if times > 1:
        raise UserError(f"{where}: seed {seed} is given twice", hint)
    return list(given)


def variant(profile: str, overrides: Mapping[str, Any]) -> str:
    """The profile's name, with a digest of the overrides where there are any."""
    if not overrides:
        return profile
    text = json.dumps(overrides, sort_keys=True, allow_nan=False)
    return f"{profile}-{hashlib.sha256(text.encode()).hexdigest()[:8]}"


def _only(
    rows: list[GridRow], axis: str, wanted: Sequence[str] | None, manifest: Manifest, beside: Iterable[str] = ()
) -> list[GridRow]:
    """The rows of the wanted names; None wants all. Names `beside` those of the rows may be wanted too."""
    if wanted is None:
        return rows
    there = {*(getattr(row, axis) for row in rows), *beside}
    if not wanted:
        raise UserError(f"--{axis}s names nothing", f"{manifest.name} has: {', '.join(sorted(there))}")
    for name in wanted:
        check_known(name, sorted(there), f'--{axis}s: {manifest.name} has no {axis} "{name}"', "it has")
    return [row for row in rows if getattr(row, axis) in wanted]


def _added(priors: Sequence[str], known: Mapping[str, Method]) -> dict[str, Method]:
    """The methods of `--prior`; a name that already means another method is refused."""
    added: dict[str, Method] = {}
    for prior in priors:
        new = residual(prior, Path.cwd())
        before = added.get(new.name, known.get(new.name))
        if before is not None and before.prior != new.prior:
            raise UserError(
                f"--prior {prior}: {new.name} already stands for the prior {before.prior}",
                "rename the function: the method is named after it",
            )
        added[new.name] = before or new
    return added


def _cell(
    manifest: Manifest, row: GridRow, method: Method, scale: str, settings: dict[str, Any]
) -> tuple[Job, RunConfig, tuple[Config, ...], DeployConfig]:
    """The row as a job of seed 0, its files read and digested once for all seeds; what must run before it; and how it
    is deployed after it.
    """
    try:
        # What --set names is seen from the command's folder, what the manifest names from its own.
        folders = {name: Path.cwd() if name in settings else manifest.path.parent for name in FILES}
        configured = taught(configure(manifest, row, method, scale, settings), manifest.name, folders)
        supplied, needed = supply(configured, scale, folders["imitation.demos"])
        config = supplied.canonical()
    except RrmError as error:
        raise UserError(f"{manifest.path}: {row.task}, {row.method}: {error}") from None
    label = Label(row.task, row.method, teacher_label(row, config), feedback_label(manifest, row, config))
    return _job(config, label), config, needed, configured.deploy


def _job(config: Config, label: Label | None = None) -> Job:
    """A run under this label; one that nothing reports is called by its method."""
    # An oracle that is only needed has a name of its own: the experiment's may be of another length.
    names = label or Label(config.task, "expert" if config.method == "oracle" else config.method)
    return Job(
        id=config.identity,
        cell=config.cell,
        **names._asdict(),
        seed=config.seed,
        steps=config.steps,
        requires=config.requires,
    )
