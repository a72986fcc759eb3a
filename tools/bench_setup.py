"""Time of ``make setup`` from nothing, in a copy of this checkout with a separate environment and pip cache.

The first run fills the cache and depends on the network. The bound applies to the second run.
"""

import os
import re
import shutil
import subprocess
import tempfile
import time
from pathlib import Path

from bench_rows import Row
from ship_testing.trials.live_run import LiveFailure

ROOT = Path(__file__).resolve().parents[1]
MOST_S = 180.0
MOST_COMPILING_S = 75.0
MOST_AGAIN_S = 1.0
MOST_GB = 1.0
_COMPILING = re.compile(r"^setup: messages and compiled modules: (\d+) s$", re.MULTILINE)


def setup_cost() -> list[Row]:
    """Return rows of setup without and with wheels in pip's cache, compilation, a second call, and size on disk."""
    with tempfile.TemporaryDirectory() as folder:
        cache = Path(folder) / "cache"
        cold_s, _ = _set_up(_copy(Path(folder) / "cold"), cache)
        shutil.rmtree(Path(folder) / "cold")
        checkout = _copy(Path(folder) / "warm")
        warm_s, output = _set_up(checkout, cache)
        again_s, _ = _set_up(checkout, cache)
        size_gb = sum(path.lstat().st_blocks for path in checkout.rglob("*")) * 512e-9
    compiling = _COMPILING.search(output)
    if compiling is None:
        raise LiveFailure(f"set-up printed no time for compiling:\n{output}")
    return [
        Row("make setup from nothing, wheels from the network", cold_s, "s"),
        Row("make setup from nothing, wheels in pip's cache", warm_s, "s", MOST_S),
        Row("of it messages and compiled modules", float(compiling[1]), "s", MOST_COMPILING_S),
        Row("make setup again", again_s, "s", MOST_AGAIN_S),
        Row("size of the checkout after make setup", size_gb, "GB", MOST_GB),
    ]


def _copy(folder: Path) -> Path:
    """Return a folder with the files of this checkout that git tracks, as they are now."""
    if not (ROOT / ".git").exists() or shutil.which("git") is None:
        raise LiveFailure(f"{ROOT} is no git checkout, or git is not installed: git lists the files to copy")
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, check=True, capture_output=True).stdout
    for name in listed.decode().split("\0")[:-1]:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        if (ROOT / name).is_symlink():
            (folder / name).symlink_to((ROOT / name).readlink())
        elif (ROOT / name).exists():
            shutil.copy2(ROOT / name, folder / name)
    return folder


def _set_up(checkout: Path, cache: Path) -> tuple[float, str]:
    """Run ``make setup``; return its duration, s, and its output."""
    kept = {name: value for name, value in os.environ.items() if name == "HOME" or name.startswith("PIP_")}
    own = str(ROOT / ".venv" / "bin")
    path = os.pathsep.join(place for place in os.environ["PATH"].split(os.pathsep) if place != own)
    begin_s = time.monotonic()
    answer = subprocess.run(
        ["make", "setup"],
        cwd=checkout,
        env={**kept, "PATH": path, "PIP_CACHE_DIR": str(cache)},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    if answer.returncode:
        raise LiveFailure(f"make setup ended with exit code {answer.returncode}:\n{answer.stdout}")
    return time.monotonic() - begin_s, answer.stdout
