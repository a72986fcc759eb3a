"""The documentation agrees with the code."""

import re
from pathlib import Path
from urllib.parse import unquote

import pytest

from tools import architecture, draw_frames
from tools.reference_pages import FOLDER, texts

ROOT = Path(__file__).parents[1]
PUBLISHED = sorted([*ROOT.glob("*.md"), ROOT / "bags" / "README.md", *(ROOT / "docs").rglob("*.md")])
LINK = re.compile(r"\]\(([^)\s]+)\)")
MOST_WORDS = 2500
HEADING = re.compile(r"^#+ +(.+)$", re.MULTILINE)


def test_the_reference_pages_are_current() -> None:
    expected = texts()
    split = {path.parent for path in map(Path, expected)} - {Path()}
    names = {*expected, *(str(path.relative_to(FOLDER)) for folder in split for path in (FOLDER / folder).iterdir())}
    current = {name: (FOLDER / name).read_text(encoding="utf-8") for name in names if (FOLDER / name).exists()}
    differing = [name for name in sorted(names) if expected.get(name) != current.get(name)]
    assert differing == [], "run tools/reference_pages.py; delete those that it does not write"


def test_the_architecture_page_has_the_packages_and_rooms_of_the_code() -> None:
    text = architecture.PAGE.read_text(encoding="utf-8")
    assert text.startswith(architecture.fixed_part()), "run tools/architecture.py"


@pytest.mark.slow
def test_the_architecture_page_has_the_ways_of_a_sample_of_the_code() -> None:
    text = architecture.PAGE.read_text(encoding="utf-8")
    assert text.endswith("".join(architecture.ways())), "run tools/architecture.py"


def test_only_arrows_that_follow_from_no_others_are_drawn() -> None:
    imports = {"top": {"middle", "bottom"}, "middle": {"bottom"}, "bottom": set()}
    assert architecture.transitive_reduction(imports) == {"top": {"middle"}, "middle": {"bottom"}, "bottom": set()}
    assert architecture.from_top(imports) == ["top", "middle", "bottom"]


def anchors(path: Path) -> set[str]:
    """Return the anchors of a page's headings, as GitHub makes them."""
    headings = HEADING.findall(re.sub(r"```.*?```", "", path.read_text(encoding="utf-8"), flags=re.DOTALL))
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("path", PUBLISHED, ids=lambda path: str(path.relative_to(ROOT)))
def test_every_link_of_a_page_leads_somewhere(path: Path) -> None:
    for link in LINK.findall(path.read_text(encoding="utf-8")):
        if link.startswith(("http://", "https://")):
            continue
        place, _, anchor = unquote(link).partition("#")
        target = (path.parent / place).resolve() if place else path
        assert target.exists(), link
        assert not anchor or anchor in anchors(target), link


def test_no_page_of_the_docs_is_too_long() -> None:
    """A page has at most 2500 words. Each bar of a table counts as a word, as in ``wc -w``."""
    words = {str(path.relative_to(ROOT)): len(path.read_text(encoding="utf-8").split()) for path in PUBLISHED}
    assert {page: count for page, count in words.items() if page.startswith("docs/") and count > MOST_WORDS} == {}


def test_every_page_that_code_names_exists() -> None:
    named = {
        (path, page)
        for folder in ("src", "tools", "examples", "test")
        for path in (ROOT / folder).rglob("*.*")
        if path.suffix in (".py", ".yaml", ".msg")
        for page in re.findall(r"\bdocs/[\w/-]+\.(?:md|png)", path.read_text(encoding="utf-8"))
    }
    assert len(named) > 10
    assert [place for place in sorted(named) if not (ROOT / place[1]).exists()] == []


def test_every_page_can_be_reached_from_the_index() -> None:
    reached, ahead = set(), [ROOT / "docs" / "index.md"]
    while ahead:
        page = ahead.pop()
        if page in reached or page.suffix != ".md" or not page.exists():
            continue
        reached.add(page)
        links = LINK.findall(page.read_text(encoding="utf-8"))
        ahead += [(page.parent / link.partition("#")[0]).resolve() for link in links if not link.startswith("http")]
    assert set((ROOT / "docs").rglob("*.md")) - reached == set()


def test_the_frames_can_be_drawn(tmp_path: Path) -> None:
    draw_frames.main(tmp_path / "frames.png")
    assert (tmp_path / "frames.png").read_bytes().startswith(b"\x89PNG")
