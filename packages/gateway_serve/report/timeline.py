"""Timeline of a run: a row for each fault and each thing injected, as HTML that fits any width."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from html import escape

#: Most numbers below a timeline that have room on a telephone.
MOST_TICKS = 6


@dataclass(frozen=True)
class Span:
    """A time in a row.

    Attributes:
        row: name of the row.
        begin: when it began [s].
        end: when it ended [s]; None: it is a moment.
    """

    row: str
    begin: float
    end: float | None = None

    @property
    def text(self) -> str:
        """Its times, for people."""
        return f"{self.begin:.3f} s" if self.end is None else f"{self.begin:.3f} s to {self.end:.3f} s"


def timeline(spans: Sequence[Span], length: float) -> str:
    """Return the rows, in the order in which they first come, over an axis in seconds.

    Args:
        spans: one or more.
        length: of the run [s].
    """
    length = max([length, 1e-3, *(span.begin if span.end is None else span.end for span in spans)])
    rows = dict.fromkeys(span.row for span in spans)
    parts = [_row(name, [span for span in spans if span.row == name], length) for name in rows]
    ticks = "".join(f'<span style="left:{_share(t, length)}">{t:g} s</span>' for t in _ticks(length))
    return f'<div class="timeline">{"".join(parts)}<div class="ticks" aria-hidden="true">{ticks}</div></div>'


def _row(name: str, spans: Sequence[Span], length: float) -> str:
    bars = "".join(
        f'<i class="moment" style="left:{_share(span.begin, length)}" title="{span.text}"></i>'
        if span.end is None
        else f'<i style="left:{_share(span.begin, length)};width:{_share(span.end - span.begin, length)}"'
        f' title="{span.text}"></i>'
        for span in spans
    )
    said = f"{name}: {'; '.join(span.text for span in spans)}"
    return f'<p>{escape(name)}</p><div class="when" role="img" aria-label="{escape(said)}">{bars}</div>'


def _share(seconds: float, length: float) -> str:
    return f"{100 * seconds / length:.4g}%"


def _ticks(length: float) -> Iterator[float]:
    """Yield round numbers from 0 on; none so near to the length that it would stick out there."""
    step = next(s for n in range(-4, 12) for s in (10.0**n, 2 * 10.0**n, 5 * 10.0**n) if length / s < MOST_TICKS)
    for k in range(MOST_TICKS):
        if k * step <= 0.96 * length:
            yield k * step
