"""The page as a whole: an overview, a chapter for each variant of each experiment, and what is told of several.

Everything is inside of it, and its policy lets a browser load nothing else and run no script but its own.
"""

from __future__ import annotations

import base64
import hashlib
import shlex
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined

import rrm
from rrmctl.errors import UserError
from rrmctl.reports.page.chapter import SEVERAL, Variant, chapter, gather, tables_at
from rrmctl.reports.page.listings import TROUBLE, columns
from rrmctl.reports.page.parts import Part, Table
from rrmctl.reports.run_facts import total
from rrmctl.reports.select import sections_of
from rrmctl.reports.series import Section
from rrmctl.reports.statistics import DEFAULTS, Statistics
from rrmctl.reports.tables import explained
from rrmctl.store.layout import check_profile, chosen_experiments, open_results
from rrmctl.store.snapshot import Snapshot


def build(
    results: str | Path = "results",
    experiments: Sequence[str] = (),
    *,
    profile: str | None = None,
    settings: Statistics = DEFAULTS,
    allow_mixed: bool = False,
) -> str:
    """The page as a document. Equal stores give equal pages.

    Args:
        experiments: only these, in this order; all of the store where none is named.
        profile: only runs at this scale.
        allow_mixed: take runs together that were made by different versions or precisions, and say so.

    Raises:
        UserError: the store holds no run of an experiment or profile that is named, or none at all; a file is damaged.
    """
    names = chosen_experiments(open_results(results), experiments)
    variants = [one for name in names for one in _variants(Snapshot(results, name), name, allow_mixed=allow_mixed)]
    check_profile(profile, (str(variant.runs[0].plan["profile"]) for variant in variants))
    variants = [variant for variant in variants if profile in (None, variant.runs[0].plan["profile"])]
    shown = (variant.section for variant in variants)
    sections = [one for one in shown if isinstance(one, Section) and (one.contained or one.answered)]
    gathered = gather(sections, settings)
    rules = [Part(title=title, rules=sentences) for title, sentences in explained().items()]
    parts = [
        _overview(variants),
        *(chapter(variant, gathered, settings) for variant in variants),
        replace(tables_at(SEVERAL, "common", gathered), title="Across experiments"),
        Part(id="explained", title="How to read the tables", parts=rules, folded=True),
    ]
    page = Part(title=f"Report: {', '.join(names)}", parts=parts)
    return render(page, _command(results, experiments, profile, settings, allow_mixed))


def _variants(store: Snapshot, experiment: str, *, allow_mixed: bool) -> Iterator[Variant]:
    """The variants of an experiment, with what may be averaged of each or why nothing may."""
    runs, needed = store.runs(), store.runs(needed=True)
    names = dict.fromkeys(str(run.plan["variant"]) for run in runs)
    shown: dict[str, Section | UserError]
    try:
        shown = {one.variant: one.refusal or one for one in sections_of(store, allow_mixed=allow_mixed)}
    except UserError as error:
        shown = dict.fromkeys(names, error)
    for name in names:
        own, others = (tuple(run for run in group if run.plan["variant"] == name) for group in (runs, needed))
        yield Variant(experiment, name, own, others, shown[name])


def _overview(variants: Sequence[Variant]) -> Part:
    shown = columns("experiment", "variant", "runs", "done", "failed", "steps", "labels", "wall_s")
    rows = []
    for variant in variants:
        failed = len({run.id for run in variant.everything if run.plan["state"] in TROUBLE})
        named = {"experiment": variant.experiment, "link": variant.id, "variant": variant.name, "failed": failed}
        rows.append(named | total(variant.everything))
    whole = total(run for variant in variants for run in variant.everything)
    words = f"{whole['done']} of {whole['runs']} planned runs are done."
    table = Table("What this page holds, runs that others need included", shown, rows)
    return Part(id="overview", title="Overview", paragraphs=[words], tables=[table])


def _command(
    results: str | Path, experiments: Sequence[str], profile: str | None, settings: Statistics, allow_mixed: bool
) -> str:
    """What makes this page again."""
    words = ["rrmctl", "report", "html", *experiments, "--results", str(results)]
    words += [] if profile is None else ["--profile", profile]
    words += [] if settings.kind == DEFAULTS.kind else ["--iqm", settings.kind]
    words += [] if settings.last == DEFAULTS.last else ["--final", f"mean-{settings.last}"]
    words += [] if settings.replicates == DEFAULTS.replicates else ["--replicates", str(settings.replicates)]
    return shlex.join([*words, *(["--allow-mixed"] if allow_mixed else [])])


def render(page: Part, command: str) -> str:
    """The document, whose own script is the only one that a browser runs; `command` makes it again."""
    here = PackageLoader(__package__, "")
    environment = Environment(loader=here, autoescape=True, undefined=StrictUndefined, trim_blocks=True)
    environment.filters["digest"] = lambda text: base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
    return environment.get_template("page.html").render(page=page, command=command, version=rrm.__version__)
