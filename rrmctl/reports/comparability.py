"""How the runs of a section were made: what must be equal among them, and what may differ but is said.

Numbers depend on more than the settings of a run. Runs of different configuration versions, packages, simulators,
devices or precisions are not averaged or compared, unless a reader asks for it; then every form of the report says so.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

from rrm.devices import CPU
from rrmctl.commands import run_commands
from rrmctl.errors import UserError
from rrmctl.labels import Label, policy
from rrmctl.planning.settings import CONFIG_VERSION
from rrmctl.reports.series import Section, Series
from rrmctl.store.layout import Layout
from rrmctl.store.provenance import asked_by, made_with, version
from rrmctl.store.snapshot import Snapshot

if TYPE_CHECKING:
    import pandas as pd

VERSION = "configuration version"
PRECISION = "precision"
DEVICE = "device"
CARD = "card"
TRUE_REWARD = "true reward on fixed states"
RENDERER = "renderer"

#: What belongs to a method, as its readers are told: it may differ between methods, and not within one.
_OF_METHODS = (DEVICE, CARD, PRECISION)

#: Of an agent's settings those that come with what a method knows beforehand.
_OF_PRIORS = ("encoder", "encoder_run")

#: Said of a fact in which deployments differ, beside the same fact of what was trained.
_DEPLOYED = " of the deployments"

#: Packages that every run uses, and what each environment says of itself (its simulator among it), as recorded.
_PACKAGES = {"versions.rrmctl": "rrmctl", "versions.torch": "torch"}
_ENVIRONMENT = "fingerprint."
#: So many series are named in a message; of more, how many there are.
_NAMED = 6


@dataclass(frozen=True)
class Making:
    """How one run was made."""

    config: Mapping[str, Any]  #: its `config.json`
    facts: Mapping[str, str]  #: what decides its numbers beside the settings, by name; what is not recorded is left out
    code: str | None  #: digest of the library's sources; None where nothing was recorded
    processor: str | None  #: its name; None where nothing was recorded


class Made(NamedTuple):
    """A run in a section."""

    label: Label
    seed: int
    run: str


#: What differs, and for each value the runs that have it.
Mixture = Mapping[str, Mapping[str, Sequence[Made]]]


def making(store: Snapshot, run: str) -> Making:
    """How this run was made. Raises UserError where its configuration is missing, or a file is damaged."""
    config, recorded = store.config(run), made_with(store.provenance(run))
    facts = {VERSION: str(config["config_version"]), PRECISION: str(config["precision"])}
    facts |= {DEVICE: str(config.get("device", CPU))}  # before there was a choice
    facts |= {CARD: recorded[CARD]} if CARD in recorded else {}
    facts |= {name: recorded[key] for key, name in _PACKAGES.items() if key in recorded}
    for key in (key for key in recorded if key.startswith(_ENVIRONMENT)):
        name = key.removeprefix(_ENVIRONMENT)
        facts.setdefault(TRUE_REWARD if name == "true_reward" else name, recorded[key])
    return Making(config, facts, recorded.get("code"), recorded.get("cpu"))


def mixture(section: Section, makings: Mapping[str, Making]) -> Mixture:
    """What differs among the runs of a section and must not.

    A method's device, its card and its precision are part of what the method is, so they are compared among the runs of
    one method; the true reward and what draws the pictures among those of one task; everything else among all. What was
    deployed may have been trained elsewhere: policies are compared with policies, deployments with deployments.
    """
    values: dict[str, dict[str, list[Made]]] = defaultdict(lambda: defaultdict(list))
    for group, among in ((section.series, ""), (section.deployments, _DEPLOYED)):
        for made in _runs(group):
            for fact, value in makings[made.run].facts.items():
                of_method = dict.fromkeys(_OF_METHODS, f" of {made.label.method}")
                of_task = dict.fromkeys((TRUE_REWARD, RENDERER), f" of {made.label.task}")
                scope = (of_method | of_task).get(fact, among)
                values[fact + scope][value].append(made)
    return {fact: dict(sorted(runs.items())) for fact, runs in values.items() if len(runs) > 1}


def told(mixed: Mixture) -> list[str]:
    """A sentence for each fact in which the runs differ."""
    return [
        f"{fact} is " + "; ".join(f"{value} in {_which(runs)}" for value, runs in values.items())
        for fact, values in mixed.items()
    ]


def remarks(section: Section, makings: Mapping[str, Making]) -> Iterator[str]:
    """What may differ among the runs and is said all the same."""
    runs = {made.run: made for made in _runs((*section.series, *section.deployments))}
    if (states := len({makings[run].code for run in runs} - {None})) > 1:
        yield f"The runs were made by {states} states of the code (digests of its sources)."
    processors: dict[str, list[Made]] = defaultdict(list)
    for run, made in runs.items():
        if (processor := makings[run].processor) is not None:
            processors[processor].append(made)
    if len(processors) > 1:
        which = "; ".join(f"{name}: {_which(of_one)}" for name, of_one in sorted(processors.items()))
        yield f"Processors differ and round in their own ways, so that a seed has another curve on each: {which}."
    if unknown := [made for run, made in runs.items() if makings[run].code is None]:
        yield f"Nothing was recorded of how these were made, and nothing could be compared: {_which(unknown)}."
    for fact in _OF_METHODS:
        methods: dict[str, dict[str, None]] = defaultdict(dict)
        for run, made in runs.items():
            if (value := makings[run].facts.get(fact)) is not None:
                methods[value][made.label.method] = None
        if len(methods) > 1:
            which = "; ".join(f"{value}: {', '.join(names)}" for value, names in sorted(methods.items()))
            yield f"Methods differ in {fact}: {which}."
    yield from _unlike_agents(section.series, makings)
    trained, deployed = (_values(group, makings) for group in (section.series, section.deployments))
    for fact in sorted(deployed.keys() & trained.keys() - {*_OF_METHODS, TRUE_REWARD}):
        if deployed[fact] - trained[fact]:
            there, then = (", ".join(sorted(values[fact])) for values in (trained, deployed))
            yield f"Policies were trained with {fact} {there} and deployed with {then}."


def _unlike_agents(series: Iterable[Series], makings: Mapping[str, Making]) -> Iterator[str]:
    """Where agents of one kind and task have several values of a setting: a profile has changed between two sweeps,
    say. What some configurations do not have, as they are older, is not known and not compared.
    """
    agents: dict[tuple[str, str], list[Mapping[str, Any]]] = defaultdict(list)
    for made in _runs(series):
        config = makings[made.run].config
        if (agent := config.get("agent")) is not None:
            agents[made.label.task, agent.get("kind", "sac")].append(agent)
    for (task, _), of_task in agents.items():
        shared = [key for key in of_task[0] if key not in _OF_PRIORS and all(key in agent for agent in of_task)]
        if unlike := [key for key in shared if any(agent[key] != of_task[0][key] for agent in of_task)]:
            yield f"Runs of {task} differ in settings of their agents: {', '.join(unlike)}."


def _values(series: Iterable[Series], makings: Mapping[str, Making]) -> Mapping[str, set[str]]:
    """What the facts are among these runs."""
    found: dict[str, set[str]] = defaultdict(set)
    for made in _runs(series):
        for fact, value in makings[made.run].facts.items():
            found[fact].add(value)
    return found


def refuse(section: Section, mixed: Mixture, layout: Layout) -> UserError:
    """What to say where runs differ that should not: training anew those that this environment would make otherwise."""
    named = {fact: fact.removesuffix(_DEPLOYED) for fact in mixed}
    now = {fact: str(CONFIG_VERSION) if name == VERSION else version(name) for fact, name in named.items()}
    stale = {
        fact: [made for value, runs in values.items() if value != now[fact] for made in runs]
        for fact, values in mixed.items()
        if now[fact] is not None  # else only a run can tell
    }
    anew = [made for runs in stale.values() for made in runs]
    older = not {named[fact] for fact in stale} - {VERSION}  # a run of another version is another run
    commands = run_commands(
        section.experiment, section.profile, section.overrides,
        [(made.label.task, policy(made.label.method), made.seed) for made in anew],
        asked=[asked_by(layout.run(made.run)) for made in anew],
        options=[] if older else ["--force"], results=layout.root,
    )  # fmt: skip
    way = f"train anew what would be made otherwise now: `{'`, `'.join(commands)}`"
    if not commands:
        way = "which of them would be made now is not known before a run in another --results folder"
    elif older:
        way += "; the old runs are then left out"
    return UserError(
        f"{section.experiment}, profile {section.profile}: its runs do not belong in one report: "
        f"{'. '.join(told(mixed))}",
        f"{way}; --allow-mixed reports them together and says so",
    )


def configurations(label: Label, rows: pd.DataFrame) -> UserError | None:
    """Why these rows of `load`, of one series and configuration version, cannot be averaged, if they cannot."""
    cells = rows.sort_values("seed").groupby("cell", sort=False)["seed"].unique()
    if len(cells) < 2:
        return None
    which = "; ".join(f"{cell} (seeds {', '.join(map(str, seeds))})" for cell, seeds in cells.items())
    return UserError(
        f"{label}: its runs were made with {len(cells)} different configurations and cannot be averaged: {which}",
        "settings or files changed from one sweep to the next; `rrmctl show RUN` tells the difference. Run it once "
        f"more as you did last, with all these seeds: --seeds {','.join(map(str, sorted(set(rows['seed']))))}; "
        "what was made otherwise is then left out",
    )


def _runs(series: Iterable[Series]) -> Iterator[Made]:
    for each in series:
        yield from (Made(each.label, seed, run) for seed, run in zip(each.seeds, each.runs, strict=True))


def _which(runs: Sequence[Made]) -> str:
    """How many runs, of which series."""
    names = list(dict.fromkeys(" ".join(made.label.words) for made in runs))
    more = [f"and {len(names) - _NAMED} more"] if len(names) > _NAMED else []
    count = len({made.run for made in runs})
    return f"{count} run{'s' if count != 1 else ''} ({', '.join([*names[:_NAMED], *more])})"
