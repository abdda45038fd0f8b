"""The names of methods: oracle, LEARNER, AGENT-PRIOR, rrm-PRIOR, rrm-LEARNER-PRIOR, and a manifest's own."""

from __future__ import annotations

import os
from collections.abc import Collection
from dataclasses import dataclass, field
from pathlib import Path

from rrm.agents import AGENTS
from rrm.config import KINDS, KNOWN, LEARNED, PRIOR_ALONE
from rrm.errors import ConfigError, nearest
from rrm.files import place
from rrm.priors import PRIORS
from rrm.priors.language import is_frozen
from rrm.registry import check_file, is_file_reference
from rrm.rewards import LEARNERS
from rrmctl.errors import UserError
from rrmctl.planning.manifest import Manifest, MethodTable, Settings
from rrmctl.planning.profiles import ProfileKind

#: The learner that a residual method's name leaves out.
BASE_LEARNER = "pebble"
#: In the path of a user's file: the task's name, for files that come one a task.
TASK = "{task}"


@dataclass(frozen=True)
class Method:
    """How a method's reward comes about, and what else it sets."""

    name: str
    learner: str
    prior: str | None
    settings: Settings = field(default_factory=dict)
    agent: str | None = None  #: the kind that its name says; None: as the profile has it for the task

    @property
    def kind(self) -> ProfileKind:
        """Known reward, learned from nothing, or learned on a prior."""
        if KINDS.get(self.learner, LEARNED).known:
            return "known"
        return "baseline" if self.prior is None else "residual"


def grammar() -> dict[str, tuple[str, str | None, str | None]]:
    """Every name that means a method without a definition: name -> (learner, prior, agent)."""
    names: dict[str, tuple[str, str | None, str | None]] = {"oracle": ("true", None, None)}
    names |= {learner: (learner, None, None) for learner in LEARNERS}
    names |= {f"{agent}-{prior}": ("prior", prior, agent) for agent in AGENTS for prior in PRIORS}
    names |= {f"rrm-{base}-{prior}": (base, prior, None) for base in LEARNERS if base not in KINDS for prior in PRIORS}
    return names | {f"rrm-{prior}": (BASE_LEARNER, prior, None) for prior in PRIORS}


def vocabulary() -> str:
    """How methods are named, and the learners and priors there are."""
    return (
        "methods: oracle, LEARNER, AGENT-PRIOR, rrm-PRIOR, rrm-LEARNER-PRIOR\n"
        f"agents: {', '.join(sorted(AGENTS))}\n"
        f"learners: {', '.join(sorted(LEARNERS))}\npriors: {', '.join(sorted(PRIORS))}"
    )


def method(name: str, manifest: Manifest) -> Method:
    """The method of this name: the manifest's own if it defines one, else by the grammar; an unknown one is refused."""
    table, names = manifest.methods.get(name, MethodTable()), grammar()
    section, folder = f"{manifest.path} [method.{name}]", manifest.path.parent
    settings = table.model_extra or {}
    if table.learner is None and table.prior is None:
        if name not in names:
            raise UserError(
                f'{manifest.path}: unknown method "{name}"{nearest(name, {*names, *manifest.methods})}',
                f"known: {', '.join(sorted(names))}; or define it in [method.{name}] with learner and prior",
            )
        learner, prior, agent = names[name]
        return Method(name, learner, prior, settings, agent)
    learners = {*LEARNERS, *(learner for learner, kind in KINDS.items() if kind.known)}
    learner = _named(table.learner or BASE_LEARNER, "learner", learners, folder, section)
    prior = None if table.prior is None else _named(table.prior, "prior", PRIORS, folder, section)
    kind = KINDS.get(learner, LEARNED)
    if kind is PRIOR_ALONE and prior is None:
        raise UserError(f'{section}: the learner "prior" trains on a prior alone; name it with prior = "..."')
    if kind is KNOWN and prior is not None:
        raise UserError(f'{section}: the learner "true" is the true reward and takes no prior')
    return Method(name, learner, prior, settings)


def residual(prior: str, folder: Path) -> Method:
    """The residual method on one prior, as `--prior` adds it; a file's is called rrm-FUNCTION."""
    name = prior.rpartition(":")[2] if is_file_reference(prior) else prior
    return Method(f"rrm-{name}", BASE_LEARNER, _named(prior, "prior", PRIORS, folder, "--prior"))


def _named(name: str, what: str, known: Collection[str], folder: Path, where: str) -> str:
    """A name of ours as it is; a user's file with its whole path, so that it is found from any folder."""
    if not is_file_reference(name):
        if name not in known:
            raise UserError(
                f'{where}: unknown {what} "{name}"{nearest(name, known)}',
                f"known: {', '.join(sorted(known))}, or path/to/file.py:name",
            )
        return name
    location, _, attribute = name.rpartition(":")
    path, frozen = folder / place(location), is_frozen(name)
    # Links are followed, but by their names language priors are told. Path.resolve dislikes links in a circle.
    whole = f"{os.path.realpath(path.parent)}/{path.name}" if frozen else os.path.realpath(path)
    if TASK not in location and not (frozen and what == "prior"):  # those are checked for each task
        try:
            check_file(f"{whole}:{attribute}", what)
        except ConfigError as error:
            raise UserError(f"{where}: {error}") from None
    return f"{whole}:{attribute}"
