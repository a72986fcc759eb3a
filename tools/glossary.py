"""The page of the glossary, written by tools/reference_pages.py from the docstring of ship_geometry."""

import inspect
import re
import textwrap
from pathlib import Path

import ship_geometry
from tools.reference_groups import WRITTEN

ROOT = Path(__file__).parents[1]

HEAD = f"""# Glossary

The terms of the suite by theme, from the docstring of `ship_geometry`, with the modules that implement them. Sources
are listed in [sources](../sources.md). The frames are drawn in [frames](../explanation/frames.md).

{WRITTEN}"""
_TERM_COLUMNS = "| term | meaning | unit, frame | source | module |\n|---|---|---|---|---|\n"


def page() -> str:
    """Return the page with all terms of the glossary, from the docstring of ship_geometry."""
    text = HEAD
    for heading, body in sections():
        if heading.startswith("Terms"):
            rows = (_term_row(term, fields) for term, fields in terms_of(body))
            content = _TERM_COLUMNS + "".join(rows)
        else:
            blocks = re.split(r"\n{2,}", body.strip())
            content = "\n\n".join(_markdown_table(block) if block.startswith("=") else block for block in blocks) + "\n"
        text += f"\n## {heading}\n\n{_as_markdown(content)}"
    return text


def sections() -> list[tuple[str, str]]:
    """Return heading and content of each section of the glossary."""
    doc = inspect.getdoc(ship_geometry) or ""
    found = re.findall(r"^(\S.*)\n( {4}\S.*\n(?: {4}.*\n|\n)*)", f"{doc}\n", re.MULTILINE)
    return [(heading, textwrap.dedent(body)) for heading, body in found]


def terms_of(section: str) -> list[tuple[str, dict[str, str]]]:
    """Return the terms of a section, each with meaning and module, and with unit and source if given."""
    terms = []
    for term, body in re.findall(r"^(\S.*)\n((?: {4}.+\n)+)", section, re.MULTILINE):
        text = " ".join(body.split())
        meaning, *rest = re.split(r"(?: |; )(unit|source|module): ", text.rstrip("."), flags=re.IGNORECASE)
        terms.append((term, {"meaning": meaning, **dict(zip(map(str.lower, rest[::2]), rest[1::2], strict=True))}))
    return terms


def _term_row(term: str, fields: dict[str, str]) -> str:
    source = f"[{fields['source']}](../sources.md)" if "source" in fields else ""
    link = f"[`{fields['module']}`](../../{module_path(fields['module']).relative_to(ROOT)})"
    cells = f"**{term}**", fields["meaning"], fields.get("unit", ""), source, link
    return f"|{'|'.join(f' {cell} ' if cell else '' for cell in cells)}|\n"


def module_path(module: str) -> Path:
    """Return the file of a module or package under src/."""
    path = ROOT.joinpath("src", module.partition(".")[0], *module.split("."))
    return path / "__init__.py" if path.is_dir() else path.with_suffix(".py")


def _markdown_table(block: str) -> str:
    """Return a table of fixed columns in Markdown; a line without a first cell continues the row above."""
    border, *lines = block.splitlines()
    starts = [match.start() for match in re.finditer("=+", border)]
    rows: list[list[str]] = []
    for line in lines:
        cells = [line[start:end].strip() for start, end in zip(starts, [*starts[1:], None], strict=True)]
        if not cells[0]:
            rows[-1] = [f"{above} {cell}".strip() for above, cell in zip(rows[-1], cells, strict=True)]
        elif not line.startswith("="):
            rows.append(cells)
    head, *rest = (f"| {' | '.join(row)} |" for row in rows)
    return "\n".join([head, "|---" * len(starts) + "|", *rest])


def _as_markdown(text: str) -> str:
    return re.sub(r"(?::\w+:)?`+([^`]+)`+", r"`\1`", text)
