"""The page of a fleet: rates of causes, which cars, how many, as one file without scripts."""

from __future__ import annotations

from html import escape
from pathlib import Path

from gateway_fleet.html import table, write
from gateway_fleet.live.answers import Answers
from gateway_fleet.live.pool import CONFIDENCE


def write_page(answers: Answers, out: Path) -> None:
    """Write the page.

    Raises:
        InputError: it cannot be written.
    """
    fleet = answers.fleet()
    said = f"{fleet['cars']} cars, {fleet['hours']:.1f} h driven, {fleet['events']} events"
    parts = [
        f"<p>{escape(said)}; until {escape(str(fleet['last']))} UTC.</p>",
        "<h2>Causes</h2>",
        f"<p>How often a cause was told, in an hour of driving; {CONFIDENCE:.0%} interval (Poisson).</p>",
        table(answers.rates()),
        "<h2>By whose limits</h2><p>0: the configuration's own; else the number of a campaign.</p>",
        table(answers.rates(("limits",))),
        "<h2>Cars</h2>",
        table(answers.cars()),
    ]
    write(out, "Fleet", parts)
