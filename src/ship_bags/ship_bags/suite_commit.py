"""Git commit of the suite that writes a bag or a page."""

import functools
import subprocess
from pathlib import Path

COMMIT_RECORD = "suite"
"""Name of the bag's metadata record with the commit of the suite that wrote the bag."""


@functools.cache
def suite_commit() -> str:
    """Return the git commit of this code, with "+changes" where files differ from it; empty outside a checkout.

    A suite installed inside the checkout of another project has no commit, because this file is not tracked there.
    """
    source = Path(__file__).resolve()
    if _git(source, "ls-files", "--error-unmatch", source.name) is None:
        return ""
    return _git(source, "describe", "--always", "--abbrev=40", "--match=", "--dirty=+changes") or ""


def commit_record() -> dict[str, str]:
    """Return the entries of :data:`COMMIT_RECORD`; empty where the commit is unknown."""
    commit = suite_commit()
    return {"commit": commit} if commit else {}


def _git(source: Path, *arguments: str) -> str | None:
    """Return the output of git in the folder of a file; None if git fails or is not installed."""
    try:
        command = ["git", "-C", str(source.parent), *arguments]
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=10.0)
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout.strip() if done.returncode == 0 else None
