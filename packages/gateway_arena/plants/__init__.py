"""Plants of the arena, by name."""

from __future__ import annotations

from gateway_arena.contract import Plant
from gateway_arena.plants.gallery import GALLERY, GalleryPlant
from gateway_arena.plants.scipy_plant import SOLVED, SolvedPlant
from gateway_arena.plants.tennessee import NAME as TENNESSEE
from gateway_arena.plants.tennessee import TennesseePlant
from gateway_arena.plants.turbo import TurboPlant
from gateway_arena.plants.valve import ValvePlant
from gateway_fdi.errors import InputError, nearest

#: Names of the plants, in the table's order.
NAMES = (*SOLVED, *GALLERY, TurboPlant.name, ValvePlant.name, TENNESSEE)


def plant(name: str) -> Plant:
    """Return a plant.

    Raises:
        InputError: there is none of this name; what simulates it is not installed.
    """
    if name not in NAMES:
        raise InputError(f"the plants are {', '.join(NAMES)}{nearest(name, NAMES)}", key="--plant", value=name)
    if name == TENNESSEE:
        return TennesseePlant()
    if name in (TurboPlant.name, ValvePlant.name):
        return TurboPlant() if name == TurboPlant.name else ValvePlant()
    return SolvedPlant(name) if name in SOLVED else GalleryPlant(name)
