"""The commit of the suite is that of its own checkout; inside another project's checkout there is none."""

import shutil
import subprocess
import sys
from pathlib import Path

import ship_bags.provenance

COMMIT_TEXT = "import provenance; print(provenance.suite_commit())"
NAMED = ("-c", "user.name=A", "-c", "user.email=a@example.org", "-c", "commit.gpgsign=false")


def commit_in(folder):
    """Return the commit that a copy of the module in a folder states."""
    done = subprocess.run([sys.executable, "-c", COMMIT_TEXT], cwd=folder, capture_output=True, text=True, check=True)
    return done.stdout.strip()


def git(folder, *words):
    return subprocess.run(["git", *words], cwd=folder, capture_output=True, text=True, check=True).stdout.strip()


def test_only_the_commit_of_its_own_checkout(tmp_path):
    file = Path(ship_bags.provenance.__file__)
    shutil.copy(file, tmp_path)
    assert commit_in(tmp_path) == ""
    git(tmp_path, "init", "-q")
    (tmp_path / "other.txt").write_text("of another project")
    git(tmp_path, "add", "other.txt")
    git(tmp_path, *NAMED, "commit", "-q", "-m", "other")
    assert commit_in(tmp_path) == ""
    git(tmp_path, "add", file.name)
    git(tmp_path, *NAMED, "commit", "-q", "-m", "suite")
    commit = git(tmp_path, "rev-parse", "HEAD")
    assert commit_in(tmp_path) == commit
    (tmp_path / "other.txt").write_text("changed")
    assert commit_in(tmp_path) == f"{commit}+changes"
