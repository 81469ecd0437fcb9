"""Plants of the arena, by name."""

from __future__ import annotations

from gateway_arena.contract import Plant
from gateway_arena.plants.gallery import GALLERY, GalleryPlant
from gateway_arena.plants.solved import SOLVED, SolvedPlant
from gateway_fdi.errors import InputError, nearest

#: Names of the plants, in the table's order.
NAMES = (*SOLVED, *GALLERY)


def plant(name: str) -> Plant:
    """Return a plant.

    Raises:
        InputError: there is none of this name.
    """
    if name not in NAMES:
        raise InputError(f"the plants are {', '.join(NAMES)}{nearest(name, NAMES)}", key="--plant", value=name)
    return SolvedPlant(name) if name in SOLVED else GalleryPlant(name)
