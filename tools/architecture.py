"""Writes docs/develop/architecture.md from the code: packages, their imports and rooms, and the way of a sample.

The way of a sample is recorded while a node processes one message; see :mod:`walk_message`.
"""

import ast
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from ship_simulation.scenario.scenario_file import load_scenario
from ship_simulation.simulate_command import write_bag

ROOT = Path(__file__).resolve().parents[1]
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

from tools.dependencies import SRC, imported_names, packages  # noqa: E402  # found by the path above, also from a script
from tools.walk_message import walk  # noqa: E402

PAGE = ROOT / "docs" / "develop" / "architecture.md"
MESSAGES = "ship_msgs"
_LEFT_OUT = "ship_geometry/", "ship_bags/"
"""Beginnings of files that are not listed in a way: pure functions of geometry, and serialisation."""

HEAD = """# Architecture

The packages in `src/`, their rooms (the folders of a package), and the files through which a sample passes. The reasons
are in [decision 6](../explanation/decisions/0006-floor-plan.md).

This page is written by `python tools/architecture.py`; a test compares it with the code.

## Packages

An arrow points from a package to a package that it imports, or whose messages it uses. Arrows that follow from others
are left out. `lint-imports` checks the directions, and the directions between the rooms of most packages, by the
contracts in `pyproject.toml`.

"""

ROOMS_HEAD = """
## Rooms

The first lines of the docstrings of packages and rooms. Packages are in the order of the drawing, from top to bottom.
"""

WAYS_HEAD = """
## Way of a sample

The files in order of the first visit, each with the first function called there, recorded while a node processed one
message. Geometry (`ship_geometry`), serialisation (`ship_bags`) and compiled functions (`ship_kernels`) are left out.
In a live node, the callback of the subscription adds the message to the inbox (`ship_node/live/live_node`,
`_on_message`). After the round of callbacks, `live_node` takes it from the inbox and calls the adapter through
`ship_node/live/adapter_calls`, which publishes the results. A replay calls the adapter with many messages at once.
[`tools/walk_message.py`](../../tools/walk_message.py) shows all visits for any message of a bag:

```bash
python tools/walk_message.py bags/demo.mcap ins/imu --list
```
"""


@dataclass(frozen=True)
class Way:
    """Message whose way is shown: heading, name of a bag in bags/ or of a scenario, topic, number of the message."""

    heading: str
    bag: str
    topic: str
    nth: int


WAYS = (
    Way("INS sample → `ship/attitude`", "demo", "ins/imu", 500),
    Way("Star exposure → ship filter", "paper_stars", "star/fore/observations", 20),
    Way("Encoder reading → track of the theodolite", "theodolite", "theodolite/encoder", 200),
    Way("Ship attitude → pointing", "theodolite", "ship/attitude", 100),
)
_SIMULATED_S = 5.0
"""Length of the simulated part of a scenario, s."""


def page() -> str:
    """Return the text of the page."""
    return fixed_part() + "".join(ways())


def fixed_part() -> str:
    """Return the page up to the ways, which is made without a replay."""
    arrows = transitive_reduction(package_imports())
    return HEAD + _drawing(arrows) + ROOMS_HEAD + "".join(map(_rooms, from_top(arrows))) + WAYS_HEAD


def package_imports() -> dict[str, set[str]]:
    """Return package → packages that it imports, or whose messages it uses."""
    known = set(packages())
    imports = {package: imported_names(SRC / package / package) & known - {package} for package in known}
    for package, imported in imports.items():
        if any(f'"{MESSAGES}/' in path.read_text(encoding="utf-8") for path in (SRC / package / package).rglob("*.py")):
            imports[package] = imported | {MESSAGES}
    return {package: set(imported) for package, imported in imports.items()}


def transitive_reduction(imports: dict[str, set[str]]) -> dict[str, set[str]]:
    """Return the arrows that do not follow from others (transitive reduction).

    Args:
        imports: package → imported packages, without circles.
    """

    def below(package: str) -> set[str]:
        return imports[package].union(*map(below, imports[package]))

    return {package: imported.difference(*map(below, imported)) for package, imported in imports.items()}


def from_top(arrows: dict[str, set[str]]) -> list[str]:
    """Return the packages so that each is before those that it imports, in order of depth, then of name."""

    def height(package: str) -> int:
        return 1 + max(map(height, arrows[package]), default=0)

    return sorted(arrows, key=lambda package: (-height(package), package))


def _drawing(arrows: dict[str, set[str]]) -> str:
    lines = [f"  {package} --> {to}" for package in from_top(arrows) for to in sorted(arrows[package])]
    return "\n".join(["```mermaid", "flowchart TB", *lines, "```", ""])


def _rooms(package: str) -> str:
    """Return the section of a package."""
    folder = SRC / package / package
    if not folder.is_dir():
        return f"\n### {package}\n\nThe messages, in `msg/` and `srv/`: [messages](../reference/messages.md).\n"
    text = f"\n### {package}\n\n{_first_line(folder / '__init__.py')}\n"
    rooms = sorted(path.parent for path in folder.rglob("__init__.py") if path.parent != folder)
    lines = [
        f"- [{room.relative_to(folder)}](../../{room.relative_to(ROOT)}): {_first_line(room / '__init__.py')}\n"
        for room in rooms
    ]
    return "".join([text, "\n" * bool(lines), *lines])


def _first_line(path: Path) -> str:
    doc = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
    return doc.partition("\n")[0].replace("``", "`")


def ways() -> Iterator[str]:
    """Yield the section of each way; each is a replay of some seconds of a bag."""
    with tempfile.TemporaryDirectory() as folder:
        for way in WAYS:
            first: dict[str, str] = {}
            for path, function in walk(_bag(way.bag, Path(folder)), way.topic, way.nth):
                if not path.startswith(_LEFT_OUT) and not function.startswith(("<", "__")):
                    first.setdefault(path, function)
            yield f"\n### {way.heading}\n\nMessage {way.nth} of `{way.topic}` in `{way.bag}`.\n\n"
            for number, (path, function) in enumerate(first.items(), 1):
                yield f"{number}. [{path.partition('/')[2]}](../../src/{path}): `{function}`\n"


def _bag(name: str, folder: Path) -> Path:
    """Return the path of a bag in bags/, or of a bag that is simulated from the scenario."""
    path = ROOT / "bags" / f"{name}.mcap"
    if path.exists():
        return path
    scenario = ROOT / "bags" / "scenarios" / f"{name}.yaml"
    path = folder / path.name
    write_bag(replace(load_scenario(scenario), duration_s=_SIMULATED_S), 1, path, scenario.read_bytes())
    return path


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
    sys.stdout.write(f"{PAGE.relative_to(ROOT)}\n")
