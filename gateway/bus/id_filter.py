"""Which frames somebody listens to, so that others never come to them."""

from __future__ import annotations

from dataclasses import dataclass

from gateway.bus.frames import Frames, has_none_of


@dataclass(frozen=True)
class IdFilter:
    """Frames that somebody listens to, on any bus.

    Attributes:
        identifiers: each with EXTENDED.
        masks: of identifiers of 29 bits that are too many to list: value (with EXTENDED), and mask of the bits that
            count.
    """

    identifiers: frozenset[int] = frozenset()
    masks: frozenset[tuple[int, int]] = frozenset()

    def also(self, more: IdFilter) -> IdFilter:
        """Return what both listen to."""
        return IdFilter(self.identifiers | more.identifiers, self.masks | more.masks)

    def has_none_of(self, frames: Frames) -> bool:
        """Return whether a batch has surely none of these, as most have none."""
        return not self.masks and (not self.identifiers or has_none_of(frames, self.identifiers))


NOTHING = IdFilter()
