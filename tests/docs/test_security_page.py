"""The ratings of docs/security.md: words of ISO/SAE 21434, and the risk that they make."""

from pathlib import Path

import pytest

PAGE = (Path(__file__).parents[2] / "docs" / "security.md").read_text()
IMPACTS = ("severe", "major", "moderate", "negligible")


def table(head):
    """Return the rows of the table with this head."""
    lines = PAGE[PAGE.index(head) :].partition("\n\n")[0].splitlines()
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in [lines[0], *lines[2:]]]


@pytest.mark.evidence("Releases: risk")
def test_each_threat_has_the_risk_of_its_impact_and_feasibility():
    head, *rows = table("| impact | very low")
    risk = {(row[0], feasibility): value for row in rows for feasibility, value in zip(head[1:], row[1:], strict=True)}
    threats = table("| attack path |")[1:]
    assert len(threats) >= 15
    for path, damaged, impact, feasibility, value, treatment in threats:
        assert value == risk[impact, feasibility], path
        assert treatment.startswith(("reduced: ", "told", "accepted", "found")), path
        assert damaged, path


def test_each_asset_is_rated_and_damaged_by_a_threat():
    assets = table("| asset | damage |")[1:]
    assert len(assets) >= 8
    threats = table("| attack path |")[1:]
    for asset, damage, *impacts in assets:
        assert damage, asset
        assert set(impacts) <= set(IMPACTS), asset
    worst = {asset: min(map(IMPACTS.index, impacts)) for asset, _, *impacts in assets}
    assert min(worst.values()) == 0, "the worst is named"
    assert max(IMPACTS.index(row[2]) for row in threats) < 3, "what harms nobody is no threat"
