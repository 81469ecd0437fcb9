"""The public names are those of docs/api.txt: no change of them is an accident."""

import importlib
import inspect
from pathlib import Path

import pytest
from surface import MODULES, surface

import gateway_fdi

LISTED = Path(__file__).parents[2] / "docs/api.txt"


@pytest.mark.evidence("Releases: surface")
def test_the_surface_is_the_listed_one():
    assert surface() == LISTED.read_text(), (
        "meant? python tests/api/surface.py > docs/api.txt, and a line in CHANGELOG.md"
    )


def test_each_public_name_says_what_it_is():
    for module in MODULES:
        found = importlib.import_module(module)
        for name in found.__all__:
            thing = getattr(found, name)
            if inspect.isclass(thing) or inspect.isfunction(thing):
                assert inspect.getdoc(thing), f"{module}.{name}"


def test_names_of_the_library_that_are_imported_late_are_all_listed():
    names = sorted(name for names in gateway_fdi._PLACES.values() for name in names)
    assert names == sorted(gateway_fdi.__all__)


@pytest.mark.parametrize(
    ("old", "new", "name"),
    [("gateway.api", "gateway_api", "open"), ("gateway.cli.doctor", "gateway_commands.doctor", "Measure")],
)
def test_an_old_name_has_the_same_things_and_warns(old, new, name):
    with pytest.warns(DeprecationWarning, match=f"{old} is {new} now"):
        found = getattr(importlib.import_module(old), name)
    assert found is getattr(importlib.import_module(new), name)
