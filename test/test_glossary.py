"""The glossary in :mod:`ship_geometry`: its modules and sources exist, and the code uses its frame letters."""

import re
from pathlib import Path

import ship_geometry
from tools import glossary

ROOT = Path(__file__).parents[1]
FRAMES = set(re.findall(r"^    ([a-z])     ", ship_geometry.__doc__ or "", re.MULTILINE))
ROTATION = re.compile(r"\brotations?_([a-z][a-z])\b(?!\()")
VECTOR = re.compile(
    r"\b(?:directions?|boresight|rate|covariance|information|noise|error|vector|axis|measured|reference|residual|centre)"
    r"_([a-z])\b"
)
SECONDS_AND_METRES = {"s", "m"}
"""Letters that name a frame and also a unit: ``error_m`` is a length."""
TERMS = [
    term for heading, body in glossary.sections() if heading.startswith("Terms") for term in glossary.terms_of(body)
]


def test_each_term_has_a_meaning_and_a_module_that_exists() -> None:
    names = [name for term, _ in TERMS for name in term.split(", ")]
    assert len(names) == len(set(names)) > 80
    assert [term for term, fields in TERMS if not fields["meaning"]] == []
    assert [term for term, fields in TERMS if not glossary.module_path(fields["module"]).exists()] == []


def test_each_source_is_listed_in_the_sources() -> None:
    listed = (ROOT / "docs" / "sources.md").read_text(encoding="utf-8")
    sources = [fields["source"] for _, fields in TERMS if "source" in fields]
    assert len(sources) > 5
    assert [source for source in sources if source not in listed] == []


def test_the_glossary_is_short() -> None:
    assert len(glossary.page().split()) <= 2500


def test_the_glossary_names_frames_once() -> None:
    rows = re.findall(r"^    ([a-z]|ENU|FLU|NED|FRD)  +\S", ship_geometry.__doc__ or "", re.MULTILINE)
    assert len(rows) == len(set(rows)) > 10


def letters_of(text: str) -> set[str]:
    """Return the frame letters at the end of the names of rotations and vectors."""
    of_rotations = {letter for pair in ROTATION.findall(text) for letter in pair if pair != "of"}
    return of_rotations | set(VECTOR.findall(text)) - SECONDS_AND_METRES


def test_every_letter_of_a_rotation_or_vector_is_a_frame_of_the_glossary() -> None:
    used = {path: letters_of(path.read_text(encoding="utf-8")) for path in ROOT.glob("src/*/*/**/*.py")}
    assert {letter for letters in used.values() for letter in letters} >= set("ndsbmt")
    assert {str(path): letters - FRAMES for path, letters in used.items() if letters - FRAMES} == {}
