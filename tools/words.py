"""Check of the language: identifiers, names, docstrings, comments, texts for the user, pages.

Each find is printed with file, line and what to use instead. The exit code is 1 if there are finds. The dictionary and
the exceptions are in ``tools/words.yaml``. Kinds of finds:

- identifier, text: a word of the dictionary, in code (identifier) or in a comment, string, docstring or page (text);
- name: a function named by a participle or particle alone;
- docstring: a first sentence that begins with a question word or a preposition;
- sentence: a sentence of more than :data:`MAX_WORDS` words in a docstring or page;
- exception: an exception that no find needs.

Example:
    python tools/words.py
"""

import io
import re
import sys
import tokenize
from collections.abc import Iterator
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path
from typing import NamedTuple

import yaml

ROOT = Path(__file__).resolve().parents[1]
DICTIONARY = "tools/words.yaml"
CHECKED = ("src", "tools", "test", "docs", "bags", "examples", ".ci", "*.md", "*.toml", "Makefile", "conftest.py")
SKIPPED = (DICTIONARY, "CHANGELOG.md", "docs/reference/*")
"""Files that are not checked: the dictionary, the change log, and generated pages, whose sources are checked."""
MAX_WORDS = 35

_PAGES = {".md", ".rst"}
_SUFFIXES = {"", ".cfg", ".css", ".html", ".j2", ".js", ".json", ".msg", ".py", ".sh", ".srv", ".toml", ".xml", ".yaml"}
_WORD = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])")
_FUNCTION = re.compile(r"^( *@(?:cached_)?property\n)? *(?:async )?def (\w+)\(", re.MULTILINE)
_TRIPLE_QUOTED = re.compile(r'(^ *r?)?"""(.*?)"""', re.MULTILINE | re.DOTALL)
_ITEM = re.compile(r"(?:[-*#>|]+|\d+\.|[\w`*<>.]+(?:, [\w`*<>.]+)*(?: \([^)]*\))?:)(?: |$)")
_INDENTED = re.compile(r"^ {4}.*", re.MULTILINE)
_SENTENCE_END = re.compile(r"(?<=[.!?])[)*_\"”]*\s+|\s\|\s")
_CODE = re.compile(r"`+[^`]*`+|\]\([^)]*\)")
_PLAIN_WORD = re.compile(r"(?<![\w’'-])(?:[aA]\b|[^\W\d_]{2})")


class Find(NamedTuple):
    """A word, name or sentence to change, with its place, what to use instead, and the whole line."""

    path: str
    line: int
    kind: str
    word: str
    use: str
    text: str = ""


@dataclass(frozen=True)
class Exemption:
    """A find that stays; ``kind``, ``word`` and ``path`` are patterns, ``within`` is a part of the line."""

    reason: str
    kind: str = "*"
    word: str = "*"
    path: str = "*"
    within: str = ""

    def covers(self, find: Find) -> bool:
        """True if the find stays."""
        pairs = (find.kind, self.kind), (find.word, self.word), (find.path, self.path)
        return all(fnmatch(text, pattern) for text, pattern in pairs) and self.within in find.text


class Dictionary:
    """Words that are not used, with what to use instead, and the exceptions.

    Args:
        text: content of the YAML file.
    """

    def __init__(self, text: str) -> None:
        given = yaml.safe_load(text)
        words = {form: use for forms, use in given["words"].items() for form in forms.split()}
        self._uses = {"text": words, "identifier": words | given["names"]}
        self._particles, self._verbs = frozenset(given["particles"].split()), frozenset(given["verbs in -ed"].split())
        self._first_words = frozenset(given["first words"].split())
        self.exemptions = [Exemption(**each) for each in given["exceptions"]]

    def finds(self, path: str, content: str) -> Iterator[Find]:
        """Yield the finds of a file, including finds that are exceptions."""
        if not self._uses["identifier"].keys().isdisjoint(map(str.lower, set(_WORD.findall(content)))):
            yield from self._words(path, content)
        if path.endswith(".py"):
            yield from self._names(path, content)
            for first, text in _docstrings(content):
                start = next(iter(text.split()), "")
                if start in self._first_words:
                    yield Find(path, first, "docstring", start, "the subject first: Return …, True if …, Number of …")
                yield from _long_sentences(path, text, first)
        elif Path(path).suffix in _PAGES:
            yield from _long_sentences(path, _INDENTED.sub("", content))

    def _words(self, path: str, content: str) -> Iterator[Find]:
        lines = content.split("\n")
        for number, kind, text in _tokens(content) if path.endswith(".py") else _lines(content):
            for word in {word.lower() for word in _WORD.findall(text)} & self._uses[kind].keys():
                yield Find(path, number, kind, word, self._uses[kind][word], lines[number - 1])

    def _names(self, path: str, content: str) -> Iterator[Find]:
        for match in _FUNCTION.finditer(content):
            is_property, name = match[1], match[2].strip("_")
            is_participle = name in self._particles or (name.endswith("ed") and name not in self._verbs)
            if is_participle and "_" not in name and not is_property:
                line = content.count("\n", 0, match.start(2)) + 1
                yield Find(path, line, "name", name, "a verb, or a noun for what is returned", match[0])


def _tokens(content: str) -> Iterator[tuple[int, str, str]]:
    """Yield line, kind of find and text of each identifier, and of each line of comments and strings."""
    texts = {tokenize.STRING, tokenize.COMMENT, getattr(tokenize, "FSTRING_MIDDLE", tokenize.STRING)}
    for token in tokenize.generate_tokens(io.StringIO(content).readline):
        if token.type == tokenize.NAME:
            yield token.start[0], "identifier", token.string
        elif token.type in texts:
            yield from _lines(token.string, token.start[0])


def _lines(text: str, first: int = 1) -> Iterator[tuple[int, str, str]]:
    return ((number, "text", line) for number, line in enumerate(text.split("\n"), first))


def _docstrings(content: str) -> Iterator[tuple[int, str]]:
    """Yield first line and text of each string in triple quotes that begins a line."""
    for match in _TRIPLE_QUOTED.finditer(content):
        if match[1] is not None:
            yield content.count("\n", 0, match.start(2)) + 1, match[2]


def _paragraphs(lines: list[str]) -> Iterator[tuple[int, str]]:
    """Yield first line and text of each paragraph and item; examples, code and tables are omitted."""
    paragraph: list[str] = []
    first, indent = 0, 0
    closing: str | None = None  # start of the line that ends the omitted part
    for number, line in enumerate([*lines, ""]):
        text = line.strip()
        if closing is not None:
            if text.startswith(closing) if closing else not text:
                closing = None
            continue
        opening = "```" if text.startswith("```") else "" if text.startswith((">>>", "====")) else None
        line_indent = len(line) - len(line.lstrip())
        if not text or opening is not None or _ITEM.match(text) or line_indent < indent:
            yield first, " ".join(paragraph)
            paragraph = []
        closing = opening
        if text and opening is None:
            first, indent = (first, indent) if paragraph else (number, line_indent)
            paragraph.append(text)


def _long_sentences(path: str, text: str, first: int = 1) -> Iterator[Find]:
    for number, paragraph in _paragraphs(text.split("\n")):
        for sentence in _SENTENCE_END.split(_CODE.sub("code", paragraph)):
            count = len(_PLAIN_WORD.findall(sentence))
            if count > MAX_WORDS:
                use = f"two sentences, not {count} words"
                yield Find(path, first + number, "sentence", f"{sentence[:40]}…", use, sentence)


def _files(root: Path) -> Iterator[tuple[str, Path]]:
    """Yield name and path of each file that is checked."""
    for top in (top for pattern in CHECKED for top in sorted(root.glob(pattern))):
        for path in sorted(top.rglob("*")) if top.is_dir() else [top]:
            name = path.relative_to(root).as_posix()
            if path.suffix in _SUFFIXES | _PAGES and path.is_file() and not any(fnmatch(name, one) for one in SKIPPED):
                yield name, path


def check(root: Path, dictionary: Dictionary) -> list[Find]:
    """Return the finds in the files below a folder, and the exceptions that no find needs."""
    files = list(_files(root))
    finds = [find for name, path in files for find in dictionary.finds(name, path.read_text(encoding="utf-8"))]
    unneeded = [
        Find(DICTIONARY, 0, "exception", each.word, f"no exception in {each.path}: {each.reason}")
        for each in dictionary.exemptions
        if any(fnmatch(name, each.path) for name, _ in files) and not any(each.covers(find) for find in finds)
    ]
    return [find for find in finds if not any(each.covers(find) for each in dictionary.exemptions)] + unneeded


def main() -> int:
    """Print the finds; return 1 if there are finds, else 0."""
    finds = check(ROOT, Dictionary((ROOT / DICTIONARY).read_text(encoding="utf-8")))
    for find in finds:
        print(f'{find.path}:{find.line}: {find.kind} "{find.word}": use {find.use}')
    return 1 if finds else 0


if __name__ == "__main__":
    sys.exit(main())
