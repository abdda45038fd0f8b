"""`rrmctl doctor --tune`: measures what the graphics cards of this machine bear."""

from __future__ import annotations

import contextlib
import json
from dataclasses import asdict

import typer

from rrm.hardware import usable_cores
from rrmctl.cli.screen import tell
from rrmctl.errors import UserError


def tune(*, as_json: bool, mps: bool = False) -> None:
    """Measure each kind of card here, with MPS or without it, say what was found and keep it for `run` and `plan`.

    Raises ConfigError where there is none that can be used, UserError where there is no MPS.
    """
    from rrm import devices
    from rrmctl.planning import card_rates
    from rrmctl.running.cards import names
    from rrmctl.running.mps import client_names, service
    from rrmctl.running.tune import Place, measure

    devices.check_device(devices.CUDA)
    cards = devices.cards()
    kinds: dict[tuple[str, int], str] = {}  # the first card of each, as CUDA_VISIBLE_DEVICES calls it
    for card, name in zip(cards, names(len(cards)), strict=True):
        kinds.setdefault((card.name, card.memory), name)
    found = {}
    for card in cards:
        if (measured := kinds.pop((card.name, card.memory), None)) is None:
            continue  # one like it was measured
        tell(f"{devices.in_words(card)}: runs train on it, more and more of them; some minutes", err=True)
        called, variables = measured, dict[str, str]()
        with contextlib.ExitStack() as served:
            if mps:
                (called,), variables = client_names([measured]), served.enter_context(service([measured]))
            rates = measure(
                Place(card=called, memory=card.memory, cores=usable_cores(), variables=variables),
                lambda count, rate: tell(f"  {count} at a time: {rate:,.0f} steps/s together", err=True),
            )
        try:
            card_rates.keep(card, rates, mps=mps)
        except OSError as error:
            file = card_rates.place(card, mps=mps)
            hint = "set XDG_CACHE_HOME to a folder that can be written"
            raise UserError(f"{file}: {error.strerror}; found was {card_rates.in_words(rates)}", hint) from error
        found[card.name] = asdict(rates) | {"best": rates.best}
        if not as_json:
            typer.echo(f"{card.name}: {card_rates.in_words(rates)}")
    if as_json:
        typer.echo(json.dumps(found, indent=2))
