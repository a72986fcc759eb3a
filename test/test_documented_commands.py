"""Every command that the documentation prints.

The unmarked ``bash`` blocks of a page are run one after another, in a folder like the checkout, with the first seconds
of each bag. Blocks marked ``live`` need nodes: the blocks for the terminals of a page are run together. Blocks marked
``shown`` need hours or the user's files and are not run, but all files that they name must exist. The page's commands
with the whole bags must print the lines of a block ``text printed``.
"""

import re
import subprocess
import time
from pathlib import Path

import pytest

from ship_bags.mcap.bag_reader import read_bag
from ship_testing.bag_parts import write_beginning
from ship_testing.trials.live_process import LiveProcess, free_domain_id, live_environment
from ship_testing.trials.live_run import executable

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", ROOT / "bags" / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
BLOCK = re.compile(r"^```(\w+)(?: (\w+))?\n(.*?)^```$", re.MULTILINE | re.DOTALL)
KEPT_S = 6
VOYAGE_S = 6
START_S = 30.0
PREPARATION = r"^(?:mkdir[^\n]*|sed[^\n]*|cat > [^\n]*<<'EOF'\n.*?^EOF$|\./ros2run ship_simulation[^\n]*)"
"""Commands that make what the terminals of a page need."""
WRITTEN = re.compile(
    r"(?:--(?:out|report|json|suite|figure)[ =]|>>? ?|black_box:=|^cp \S+ )(out/[\w./-]*[\w-])", re.MULTILINE
)
"""A file or folder that a command writes."""


def blocks(page: Path, mark: str, language: str = "bash") -> list[str]:
    """Return the blocks of a page in a language with a mark; an empty mark for bash blocks that are run."""
    found = BLOCK.findall(page.read_text(encoding="utf-8"))
    return [body for written_in, marked, body in found if written_in == language and marked == mark]


def printed_lines(page: Path) -> list[str]:
    """Return lines that the commands of a page print, as stated on the page."""
    return [line for body in blocks(page, "printed", "text") for line in body.splitlines()]


def name(page: Path) -> str:
    return str(page.relative_to(ROOT))


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """Return a folder that looks like the checkout, with short bags."""
    folder = linked_checkout(tmp_path, "bags")
    (folder / "bags").mkdir()
    for path in (ROOT / "bags").glob("*.mcap"):
        write_beginning(path, folder / "bags" / path.name, KEPT_S)
    return folder


def linked_checkout(tmp_path: Path, *left_out: str) -> Path:
    """Return a folder with links to the files of the checkout, except results and `left_out`."""
    folder = tmp_path / "checkout"
    folder.mkdir()
    for path in ROOT.iterdir():
        if path.name not in ("out", "log", ".git", *left_out):
            (folder / path.name).symlink_to(path)
    return folder


def test_no_two_pages_write_the_same_file() -> None:
    """Commands of several pages in one checkout never write to an existing file."""
    pages: dict[str, set[str]] = {}
    for page in PAGES:
        for path in WRITTEN.findall("".join(blocks(page, "") + blocks(page, "live") + blocks(page, "shown"))):
            pages.setdefault(path, set()).add(name(page))
    assert len(pages) > 50
    assert {path: sorted(writers) for path, writers in pages.items() if len(writers) > 1} == {}


@pytest.mark.slow
@pytest.mark.parametrize("page", [page for page in PAGES if printed_lines(page)], ids=name)
def test_the_commands_of_a_page_print_the_numbers_that_it_states(page: Path, tmp_path: Path) -> None:
    script = "set -eu\n" + "".join(blocks(page, ""))
    folder = linked_checkout(tmp_path)
    run = subprocess.run(["bash", "-c", script], cwd=folder, capture_output=True, text=True, timeout=600, check=False)
    assert run.returncode == 0, run.stdout[-2000:] + run.stderr[-2000:]
    assert [line for line in printed_lines(page) if line not in run.stdout.splitlines()] == []


@pytest.mark.slow
@pytest.mark.parametrize("page", [page for page in PAGES if blocks(page, "") and not printed_lines(page)], ids=name)
def test_the_commands_of_a_page_run_as_printed(page: Path, checkout: Path) -> None:
    script = "set -eu\n" + "".join(blocks(page, "")).replace("duration_s: 30.0", f"duration_s: {VOYAGE_S}.0")
    run = subprocess.run(["bash", "-c", script], cwd=checkout, capture_output=True, text=True, timeout=300, check=False)
    assert run.returncode == 0, run.stdout[-2000:] + run.stderr[-2000:]


@pytest.mark.parametrize("page", [page for page in PAGES if blocks(page, "live") + blocks(page, "shown")], ids=name)
def test_files_named_by_the_other_commands_of_a_page_exist(page: Path) -> None:
    pages = (ROOT / "docs" / "reference" / "executables").glob("*.md")
    shown = "".join(page.read_text(encoding="utf-8") for page in pages)
    helps = dict(re.findall(r"^## `(\w+)`\n(.*?)(?=^## |\Z)", shown, re.MULTILINE | re.DOTALL))
    targets = set(re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    for line in "".join(blocks(page, "live") + blocks(page, "shown")).splitlines():
        words = line.partition("#")[0].split()
        in_checkout = "bags/", "examples/", "src/", "test/", "tools/"
        assert all((ROOT / word).exists() for word in words if word.startswith(in_checkout))
        if words[:1] == ["make"]:
            assert words[1] in targets
        elif words[:1] == ["./ros2run"]:
            assert executable(*words[1:3])
            help_text = helps[words[2]]
            own = words[3 : words.index("--ros-args")] if "--ros-args" in words else words[3:]
            assert [word for word in own if word.startswith("--") and word not in help_text] == []
        else:
            assert words[:1] in ([], ["cd"], ["export"], ["pytest"], ["python"], ["ssh"])


def wait_until_it_listens(process: LiveProcess) -> None:
    """Return when a node or a recorder has printed its first line."""
    end_s = time.monotonic() + START_S
    while not process.log_text().strip():
        assert time.monotonic() < end_s, process.log_text()
        time.sleep(0.05)


@pytest.mark.live
@pytest.mark.parametrize(
    "page",
    [pytest.param(ROOT / "README.md", marks=pytest.mark.smoke), ROOT / "docs" / "tutorial" / "first_hour.md"],
    ids=name,
)
def test_the_three_terminals_of_a_page(page: Path, checkout: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Run node and recorder, and play the bag, as printed; then run the page's commands on the recorded files."""
    monkeypatch.chdir(checkout)
    script = "set -eu\n" + "\n".join(re.findall(PREPARATION, "".join(blocks(page, "")), re.MULTILINE | re.DOTALL))
    script = script.replace("duration_s: 30.0", f"duration_s: {VOYAGE_S}.0")
    subprocess.run(["bash", "-c", script], cwd=checkout, check=True, capture_output=True, timeout=300)
    lines = [line.split() for line in "".join(blocks(page, "live")).splitlines() if line.startswith("./ros2run")]
    node, recorder, player, *afterwards = ([*executable(*words[1:3]), *words[3:]] for words in lines)
    environment = live_environment(free_domain_id(), checkout / "ros")
    with (
        LiveProcess(node, checkout / "node.log", environment) as node_process,
        LiveProcess(recorder, checkout / "recorder.log", environment) as recorder_process,
    ):
        wait_until_it_listens(node_process)
        wait_until_it_listens(recorder_process)
        subprocess.run(player, check=True, capture_output=True, timeout=120, env=environment)
        assert node_process.end() == 0, node_process.log_text()
        assert recorder_process.end() == 0, recorder_process.log_text()
    for command in afterwards:
        subprocess.run(command, check=True, capture_output=True, timeout=120)
    recorded = checkout / recorder[recorder.index("--out") + 1]
    with read_bag(recorded) as bag:
        assert sum(1 for _ in bag.records(["/ship/attitude"])) > 100
