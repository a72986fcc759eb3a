"""Tests of tools/words.py: it reports nothing in the repository, and each kind of find with the word to use instead."""

from pathlib import Path

import pytest

from tools import words

TEXT = (words.ROOT / words.DICTIONARY).read_text(encoding="utf-8")
NO_EXCEPTIONS = TEXT.partition("\nexceptions:")[0] + "\nexceptions: []\n"
CODE = '''"""{start} the INS has an offset."""


def {name}() -> None:
    """Return {word} data."""
    {word}_ns = 0  # {word} before


class Sample:
    @property
    def {name}(self) -> int:
        return 0


TEXT = "the offset was {word} by the node"
'''
LONG = " ".join(["word"] * (words.MAX_WORDS + 1))


@pytest.fixture
def root(tmp_path: Path) -> Path:
    for folder in ("src", "docs"):
        (tmp_path / folder).mkdir()
    return tmp_path


def finds_in(root: Path) -> list[words.Find]:
    return words.check(root, words.Dictionary(NO_EXCEPTIONS))


def test_the_repository_has_no_find() -> None:
    assert words.check(words.ROOT, words.Dictionary(TEXT)) == []


def test_each_kind_of_find_in_code_is_reported_with_what_to_use(root: Path) -> None:
    (root / "src" / "module.py").write_text(CODE.format(start="Whether", name="_kept", word="heard"), encoding="utf-8")
    assert {(find.line, find.kind, find.word): find.use for find in finds_in(root)} == {
        (1, "docstring", "Whether"): "the subject first: Return …, True if …, Number of …",
        (4, "name", "kept"): "a verb, or a noun for what is returned",
        (5, "text", "heard"): "receive",
        (6, "identifier", "heard"): "receive",
        (6, "text", "heard"): "receive",
        (15, "text", "heard"): "receive",
    }


@pytest.mark.parametrize("name", ["module.js", "Message.msg", "page.html.j2", "suite.yaml"])
def test_words_in_other_files_are_reported(root: Path, name: str) -> None:
    (root / "src" / name).write_text("# the offset\n# isHeardNow\n", encoding="utf-8")
    assert [find[:4] for find in finds_in(root)] == [(f"src/{name}", 2, "text", "heard")]


def test_a_part_of_another_word_is_no_find(root: Path) -> None:
    (root / "docs" / "page.rst").write_text("An applied fortelling essay.\n", encoding="utf-8")
    assert finds_in(root) == []


def test_long_sentences_are_reported_and_formulas_examples_and_code_are_none(root: Path) -> None:
    code, short = f"    {LONG}\n", "word " * (words.MAX_WORDS - 1)
    page = f"# Heading\n\n{short}.\n{short}.\n\n- {short}\n- {short}\n\n{code}\n```\n{LONG}\n```\n\n{LONG}.\n"
    (root / "docs" / "page.rst").write_text(page, encoding="utf-8")
    formula = " + ".join(f"a_{i} x^{i}" for i in range(words.MAX_WORDS))
    docstring = f'"""Return a polynomial.\n\n    y = {formula}\n\n>>> {LONG}\n{LONG}\n\n{LONG}.\n"""\n'
    (root / "src" / "module.py").write_text(docstring, encoding="utf-8")
    in_code, in_page = finds_in(root)
    assert in_code[:3] == ("src/module.py", 8, "sentence")
    assert in_page[:3] == ("docs/page.rst", 15, "sentence")
    assert f"not {words.MAX_WORDS + 1} words" in in_page.use


def test_an_exception_that_no_find_needs_is_reported(root: Path) -> None:
    (root / "docs" / "page.rst").write_text("The offset is heard.\n", encoding="utf-8")
    exception = "{word: heard, path: docs/*, within: offset is, reason: needed}"
    dictionary = words.Dictionary(NO_EXCEPTIONS.replace("[]", f"[{exception}]"))
    assert words.check(root, dictionary) == []
    (root / "docs" / "page.rst").write_text("The offset is received.\n", encoding="utf-8")
    [find] = words.check(root, dictionary)
    assert (find.path, find.kind, find.word) == (words.DICTIONARY, "exception", "heard")
    assert "needed" in find.use


def test_finds_end_with_exit_code_1(root: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture) -> None:
    (root / "tools").mkdir()
    (root / "docs" / "page.rst").write_text("The offset is heard.\n", encoding="utf-8")
    (root / words.DICTIONARY).write_text(TEXT, encoding="utf-8")
    monkeypatch.setattr(words, "ROOT", root)
    assert words.main() == 1
    assert 'docs/page.rst:1: text "heard": use receive' in capsys.readouterr().out
