"""Crankshaft trigger wheels: teeth on equal pitches, some of them missing or added."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Annotated

from pydantic import PlainSerializer, PlainValidator

_SHORT = re.compile(r"(\d+)((?:-\d+){1,2})")
_EQUAL = re.compile(r"(\d+)(?:-0)?")
_ADDED = re.compile(r"(\d+)\+1")
#: Wheels whose gaps do not lie evenly, by their names: Subaru's with 13, 16 and 1 teeth between three gaps,
#: Mitsubishi's with 11, 11 and 10, and Mazda's four teeth that are 70 and 110 degrees apart.
_KNOWN = {
    "36-2-2-2": "12*1,3,15*1,3,3",
    "36-2-1-1": "10*1,2,10*1,2,9*1,3",
    "4-2": ",".join(["0.7778,1.2222"] * 2),
}
_RUN = re.compile(r"(?:(\d+)\*)?(\d+(?:\.\d+)?)")

#: Pulses that a wheel can have: one of equal pitches, and one with a gap.
MOST_TEETH, MOST_GAPPED = 360, 180
#: A wheel of fewer pulses is laid out over several turns, of at least so many pulses together; so is one of equal
#: pitches with fewer than the third.
FEW, LAID_OUT, FEW_EVEN = 4, 8, 12


@dataclass(frozen=True)
class Wheel:
    """A wheel as the pitches between its pulses.

    Attributes:
        text: as it was written.
        pitches: shape (P,), pitches from pulse i to pulse i + 1; pulse 0 is the first one after the
            largest gap, so the last entry is that gap.
    """

    text: str
    pitches: tuple[float, ...]

    def __str__(self) -> str:
        return self.text

    @property
    def pulses(self) -> int:
        """Pulses in one revolution."""
        return len(self.pitches)

    @property
    def turn(self) -> float:
        """Pitches in one revolution."""
        return sum(self.pitches)

    @property
    def repeats(self) -> int:
        """Pulses after which the pattern repeats: fewer than ``pulses`` for a wheel of equal parts."""
        count = self.pulses
        return next(
            k for k in range(1, count + 1) if count % k == 0 and self.pitches == self.pitches[k:] + self.pitches[:k]
        )

    @property
    def even(self) -> bool:
        """Whether all pitches are equal: then the pulses do not tell a place on the wheel."""
        return self.repeats == 1

    @property
    def lone(self) -> bool:
        """Whether one gap is all that its pitches differ by."""
        return self.pitches[-1] > 1.0 and all(pitch == 1.0 for pitch in self.pitches[:-1])

    @property
    def tiles(self) -> int:
        """Turns that lie one behind the other in :attr:`laid_out`: 1, of a wheel of few pulses whole working cycles."""
        if self.pulses >= (FEW_EVEN if self.even else FEW):
            return 1
        return next(turns for turns in (2, 4, 8) if turns * self.pulses >= LAID_OUT)

    @property
    def laid_out(self) -> Wheel:
        """The wheel over so many turns that its pulses are enough to be followed; a turn is one of its equal parts."""
        return self if self.tiles == 1 else Wheel(self.text, self.pitches * self.tiles)

    @property
    def positions(self) -> tuple[float, ...]:
        """Angle of each pulse [pitch], pulse 0 at zero."""
        angles, angle = [], 0.0
        for pitch in self.pitches:
            angles.append(angle)
            angle += pitch
        return tuple(angles)

    @classmethod
    def parse(cls, text: str) -> Wheel:
        """Read a wheel.

        * ``60-2``: 60 pitches, 2 neighbouring teeth missing.
        * ``36-2-1``: two gaps whose far ends lie half a turn apart (Mitsubishi 4B11 and others).
        * ``36-2-2-2``: Subaru's, with 13, 16 and 1 teeth between its gaps; ``36-2-1-1``: Mitsubishi's, with 11, 11
          and 10.
        * ``4-2``: Mazda's, with teeth 70 and 110 degrees apart, twice a turn.
        * ``12+1``: 12 teeth and one more halfway between two of them.
        * ``24``, ``24-0``: 24 equal pitches, no gap. 1 to 360.
        * ``29*1,3`` or ``1,1,2.5,...``: the pitches themselves, ``n*pitch`` for runs, in any unit (degrees).

        Raises:
            ValueError: anything else, or a wheel of more pulses than :data:`MOST_GAPPED` (of equal pitches
                :data:`MOST_TEETH`).
        """
        compact = text.replace(" ", "")
        compact = _KNOWN.get(compact, compact)
        if found := _EQUAL.fullmatch(compact):
            pitches = [1.0] * min(int(found[1]), MOST_TEETH + 1)
        elif found := _ADDED.fullmatch(compact):
            teeth = int(found[1])
            pitches = [1.0] * (teeth - 1) + [0.5, 0.5]
        elif found := _SHORT.fullmatch(compact):
            pitches = _with_gaps(text, int(found[1]), [int(n) for n in found[2][1:].split("-")])
        else:
            pitches = []
            for part in compact.split(","):
                run = _RUN.fullmatch(part)
                if run is None:
                    raise ValueError(
                        f'{text!r} is not a wheel: write "60-2", "36-2-1", "12+1", "24", or its pitches as "57*1,3"'
                    )
                pitches += [float(run[2])] * int(run[1] or 1)
        if not pitches or min(pitches) <= 0:
            raise ValueError(f"{text!r}: a wheel has at least one pulse, and all pitches above zero")
        unit = _unit(pitches)
        pitches = [pitch / unit for pitch in pitches]
        most = MOST_TEETH if len(set(pitches)) == 1 else MOST_GAPPED
        if len(pitches) > most:
            raise ValueError(
                f"{text!r}: a wheel has 1 to {MOST_GAPPED} pulses, one whose pitches are equal 1 to {MOST_TEETH}"
            )
        largest = max(range(len(pitches)), key=lambda k: pitches[k])
        turned = pitches[largest + 1 :] + pitches[: largest + 1]
        return cls(text, tuple(turned))


def _unit(pitches: list[float]) -> float:
    """Return the pitch that most pulses have; of two as frequent, and of no common measure, the mean of all.

    One is the unit where no other pitch is more frequent: they are given in pitches.
    """
    most = max(pitches.count(pitch) for pitch in set(pitches))
    if pitches.count(1.0) == most:
        return 1.0
    unit = min(pitch for pitch in set(pitches) if pitches.count(pitch) == most)
    common = 2 * most > len(pitches) or all((2 * pitch / unit) % 1 == 0 for pitch in pitches)
    return unit if common else sum(pitches) / len(pitches)


def _wheel(value: object) -> Wheel:
    return value if isinstance(value, Wheel) else Wheel.parse(str(value))


#: A wheel in TOML, written as :meth:`Wheel.parse` reads it.
WheelText = Annotated[Wheel, PlainValidator(_wheel, json_schema_input_type=str), PlainSerializer(str)]


def _with_gaps(text: str, teeth: int, missing: list[int]) -> list[float]:
    if sum(missing) + 2 * len(missing) > teeth or 0 in missing:
        raise ValueError(f"{text!r}: more teeth missing than the wheel has")
    # Tooth places 0 .. teeth - 1; each gap ends an equal share of the turn after the last.
    gone: set[int] = set()
    for k, number in enumerate(missing):
        end = missing[0] + k * teeth // len(missing)
        gone.update(range(end - number, end))
    there = [place for place in range(teeth) if place not in gone]
    following = [*there[1:], there[0] + teeth]
    return [float(b - a) for a, b in zip(there, following, strict=True)]
