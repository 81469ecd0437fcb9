"""Links of the pages: what they point at is there, and the index lists every page; the form of the changelog."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = [
    *(ROOT / f"{name}.md" for name in ("README", "CONTRIBUTING", "SECURITY", "CHANGELOG")),
    *sorted(DOCS.rglob("*.md")),
]
FENCE = re.compile(r"^ *```.*?^ *```", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\(([^)\s]+)\)")


def prose(page):
    """Return a page without its blocks of code, in which brackets and # mean something else."""
    return FENCE.sub("", page.read_text(encoding="utf-8"))


def anchors(page):
    """Return the anchors of a page's headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.+)$", prose(page), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def broken(page, text):
    """Return the relative links in the text of a page whose file or heading does not exist."""
    found = []
    for link in LINK.findall(text):
        if re.match(r"[a-z]+:", link):
            continue
        path, _, anchor = link.partition("#")
        target = page.parent / path if path else page
        if not target.exists() or (anchor and anchor not in anchors(target)):
            found.append(link)
    return found


@pytest.mark.evidence("Releases: docs")
@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_what_links_point_at_exists(page):
    assert broken(page, prose(page)) == []


def test_broken_links_are_found():
    text = "[a](gone.md) [b](daemon.md#gone) [c](#gone) [d](daemon.md#the-clock) [e](https://example.org/gone.md)"
    assert broken(DOCS / "page.md", text) == ["gone.md", "daemon.md#gone", "#gone"]


def test_the_index_lists_every_page_in_one_wing():
    text = prose(DOCS / "README.md")
    assert re.findall(r"^## (.*)$", text, re.MULTILINE) == ["Tutorials", "How-to", "Reference", "Explanation"]
    listed = sorted(link for link in LINK.findall(text) if link.endswith(".md") and not link.startswith("../"))
    assert listed == sorted(str(page.relative_to(DOCS)) for page in DOCS.rglob("*.md") if page != DOCS / "README.md")


def test_the_pages_stay_short_enough_to_be_read():
    """Tables and blocks of code count; evidence.md, which is made, and what happened (the changelog) do not."""
    made = {"evidence", "CHANGELOG"}
    words = {page.name: len(page.read_text(encoding="utf-8").split()) for page in PAGES if page.stem not in made}
    longest = sorted(words, key=words.__getitem__, reverse=True)[:5]
    assert sum(words.values()) < 55_000, longest


def test_the_changelog_is_kept_as_keep_a_changelog_says():
    text = (ROOT / "CHANGELOG.md").read_text()
    versions = re.findall(r"^## (.*)$", text, re.MULTILINE)
    assert versions[0] == "[Unreleased]"
    assert all(re.fullmatch(r"\[\d+\.\d+\.\d+\]( - \d{4}-\d\d-\d\d)?", version) for version in versions[1:])
    for version in text.split("\n## ")[1:]:
        kinds = re.findall(r"^### (.*)$", version, re.MULTILINE)
        order = ["Added", "Changed", "Deprecated", "Removed", "Fixed", "Security"]
        assert kinds == [kind for kind in order if kind in kinds]
