"""The page as a whole: an overview, a chapter for each variant of each experiment, and what is told of several.

Everything is inside of it, and its policy lets a browser load nothing else and run no script but its own.
"""

from __future__ import annotations

import base64
import hashlib
import shlex
from collections.abc import Iterator, Sequence
from dataclasses import replace
from importlib import resources
from pathlib import Path

import rrm
from rrmctl.errors import UserError
from rrmctl.reports import names as asked
from rrmctl.reports.accounts import total
from rrmctl.reports.kinds import explained
from rrmctl.reports.page.chapter import Part, Variant, chapter, tables_at
from rrmctl.reports.page.gather import SEVERAL, gather
from rrmctl.reports.page.html import Html, element, joined
from rrmctl.reports.page.listings import TROUBLE, clock
from rrmctl.reports.page.tables import Column, of_rows
from rrmctl.reports.select import read_sections
from rrmctl.reports.series import Section
from rrmctl.reports.settings import DEFAULTS, Settings
from rrmctl.store.inventory import inventory
from rrmctl.store.reader import open_results

_WHOLE = "{:,.0f}".format


def build(
    results: str | Path = "results",
    experiments: Sequence[str] = (),
    *,
    profile: str | None = None,
    settings: Settings = DEFAULTS,
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
    names = asked.experiments(open_results(results), experiments)
    found = [each for name in names for each in _variants(results, name, allow_mixed=allow_mixed)]
    asked.check_profile(profile, (str(each.runs[0].plan["profile"]) for each in found))
    variants = [each for each in found if profile in (None, each.runs[0].plan["profile"])]
    sections = [each.section for each in variants if isinstance(each.section, Section) and each.section.contained]
    gathered = gather(sections, settings)
    common = tables_at(SEVERAL, "common", gathered)
    parts = [
        Part("overview", "Overview", _overview(variants)),
        *(chapter(each, gathered, settings) for each in variants),
        *([replace(common, title="Across experiments")] if common.body else ()),
        Part("explained", "How to read the tables", joined(_explained()), folded=True),
    ]
    made = _made(_command(results, experiments, profile, settings, allow_mixed))
    return _whole(f"Report: {', '.join(names)}", parts, made)


def _variants(results: str | Path, experiment: str, *, allow_mixed: bool) -> Iterator[Variant]:
    """The variants of an experiment, with what may be averaged of each or why nothing may."""
    runs, needed = inventory(results, experiment), inventory(results, experiment, needed=True)
    shown: dict[str, Section | UserError] = {}
    try:
        found = read_sections(results, experiment, allow_mixed=allow_mixed)
        shown = {section.variant: section.refusal or section for section in found}
    except UserError as error:
        shown = dict.fromkeys((str(run.plan["variant"]) for run in runs), error)
    for variant in dict.fromkeys(str(run.plan["variant"]) for run in runs):
        own, others = (tuple(run for run in group if run.plan["variant"] == variant) for group in (runs, needed))
        yield Variant(experiment, variant, own, others, shown[variant])


def _overview(variants: Sequence[Variant]) -> Html:
    columns = [Column("Experiment"), Column("Variant")]
    columns += [Column(name, number=True, show=_WHOLE) for name in ("Runs", "Done", "Failed", "Steps", "Labels")]
    columns += [Column("Time", number=True, show=clock)]
    rows = []
    for variant in variants:
        spent = total(variant.everything)
        failed = len({run.id for run in variant.everything if run.plan["state"] in TROUBLE})
        link = element("a", variant.experiment, href=f"#{variant.id}")
        sums = (spent[name] for name in ("steps", "labels", "wall_s"))
        rows.append([link, variant.name, spent["runs"], spent["done"], failed, *sums])
    whole = total(run for variant in variants for run in variant.everything)
    told = element("p", f"{whole['done']} of {whole['runs']} planned runs are done.")
    return joined([told, of_rows(columns, rows, "What this page holds, runs that others need included")])


def _command(
    results: str | Path, experiments: Sequence[str], profile: str | None, settings: Settings, allow_mixed: bool
) -> str:
    """What makes this page again."""
    words = ["rrmctl", "report", "html", *experiments, "--results", str(results)]
    words += [] if profile is None else ["--profile", profile]
    words += [] if settings.kind == DEFAULTS.kind else ["--iqm", settings.kind]
    words += [] if settings.replicates == DEFAULTS.replicates else ["--replicates", str(settings.replicates)]
    return shlex.join([*words, *(["--allow-mixed"] if allow_mixed else [])])


def _explained() -> Iterator[Html]:
    for title, sentences in explained().items():
        yield element("h3", title)
        yield element("ul", *(element("li", sentence) for sentence in sentences))


def _made(command: str) -> Html:
    """How the page came about."""
    told = f"Written by rrmctl {rrm.__version__}, with "
    return element("footer", element("p", told, element("code", command)))


def _whole(heading: str, parts: Sequence[Part], made: Html) -> str:
    style, script = (resources.files(__package__).joinpath(name).read_text() for name in ("page.css", "page.js"))
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    policy = f"default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'sha256-{digest}'"
    head = element(
        "head",
        element("meta", charset="utf-8"),
        element("meta", http_equiv="Content-Security-Policy", content=policy),
        element("meta", name="viewport", content="width=device-width, initial-scale=1"),
        element("meta", name="color-scheme", content="light dark"),
        element("title", heading),
        element("style", Html(style)),
    )
    entries = element("ul", *(part.entry() for part in parts))
    contents = element("details", element("summary", "Contents"), entries, open=True)
    body = element(
        "body",
        element("a", "Skip to the report", href="#overview", class_="skip"),
        element("header", element("h1", heading)),
        element(
            "div",
            element("nav", contents, aria_label="Contents"),
            element("main", *(part.html() for part in parts), made),
            class_="sides",
        ),
        element("dialog", aria_label="Enlarged figure"),
        element("script", Html(script)),
    )
    return f"<!doctype html>\n{element('html', head, body, lang='en')}\n"
