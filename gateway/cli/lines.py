"""Lines for people: wrapped at words, continuation lines are indented; colours on terminals only."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console

#: Columns of lines that do not go to a terminal, and of one whose size is not known.
WIDTH = 80
#: A space at which a line may end: not before a unit.
_SPACE = r" (?!\[|m?s(?:\W|$))"
#: Where text begins that goes on from a line that has a time.
HANG = 14


def wrapped(text: str, width: int = WIDTH, hang: int = HANG) -> str:
    """Return a text in lines of at most ``width`` columns, broken between groups, or else between words.

    Two spaces or more part groups: "count 1  speed [rpm] 1504" is broken before "speed" rather than in it. A word that
    is longer than a line stays whole: it may be a path that a user copies.

    Args:
        text: one line, or several.
        width: of a line.
        hang: spaces before all lines but the first.
    """
    if "\n" in text:
        return "\n".join(wrapped(line, width, hang) for line in text.split("\n"))
    lines, line = [], ""
    for gap, group in re.findall(r"(^ *| {2,})([^ ]+(?: [^ ]+)*)", text):
        fits = len(line) + len(gap) + len(group) <= width
        if not fits and line.strip() and hang + len(group) <= width:
            lines.append(line)
            line = " " * hang + group
            continue
        for k, word in enumerate(re.split(_SPACE, group)):
            space = " " if k else gap
            if line.strip() and len(line) + len(space) + len(word) > width:
                lines.append(line)
                line = " " * hang + word
            else:
                line += space + word
    return "\n".join([*lines, line])


def number(value: float | None, digits: int = 6) -> str:
    """Return a number for people, "-" for none; whole ones, and those above, have all their digits before the point."""
    if value is None:
        return "-"
    if abs(value) < 1e12 and (value == round(value) or abs(value) >= 10**digits):
        return f"{value + 0.0:.0f}"
    return f"{value:.{digits}g}"


class Lines:
    """Prints lines to stdout, wrapped to the terminal, or to 80 columns where there is none."""

    def __init__(self) -> None:
        from rich.console import Console  # noqa: PLC0415 - slow to load

        self._console: Console = Console(highlight=False, soft_wrap=True)

    @property
    def width(self) -> int:
        """Columns of a line."""
        return self._console.width if self._console.is_terminal else WIDTH

    def print(self, text: str, *, mark: str = "", colour: str = "", style: str = "", hang: int = HANG) -> None:
        """Print one text.

        Args:
            text: of the line.
            mark: words in it that get the colour.
            colour: of them.
            style: of the whole.
            hang: spaces before all lines but the first.
        """
        from rich.text import Text  # noqa: PLC0415 - slow to load

        shown = Text(wrapped(text, self.width, hang), style=style)
        at = shown.plain.find(mark) if mark else -1
        if at >= 0:
            shown.stylize(colour, at, at + len(mark))
        self._console.print(shown)
