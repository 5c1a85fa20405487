"""What results say of the sources that made them."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
ASK = """
from pathlib import Path
from baselines.tools import provenance
print(provenance.commit())
try:
    print(provenance.last_commit_of(Path(provenance.__file__)))
except ValueError:
    print("refused")
"""


def git(folder: Path, *words: str) -> str:
    known = [("user.name", "A"), ("user.email", "a@b.c"), ("commit.gpgsign", "false"), ("init.defaultBranch", "main")]
    settings = [word for name, value in known for word in ("-c", f"{name}={value}")]
    ran = subprocess.run(["git", *settings, *words], cwd=folder, capture_output=True, text=True, check=True)
    return ran.stdout.strip()


def sources_in(folder: Path) -> Path:
    """Copy what tells of provenance into a folder."""
    for name in ("beltarm_env/__init__.py", "beltarm_env/sources.py", "beltarm_env/timing.py", "baselines/tools"):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        copy = shutil.copytree if (ROOT / name).is_dir() else shutil.copy
        copy(ROOT / name, folder / name)
    (folder / "baselines/__init__.py").touch()
    (folder / ".gitignore").write_text("__pycache__/\n")
    return folder


def repository(folder: Path) -> Path:
    """Make a repository with one commit of all that is in the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "theirs.txt").touch()
    git(folder, "init")
    git(folder, "add", ".")
    git(folder, "commit", "-m", "all")
    return folder


def told(sources: Path, **environment: str) -> list[str]:
    """Commit of the sources, and last commit of a file of theirs."""
    ran = subprocess.run(
        [sys.executable, "-c", ASK],
        env={**os.environ, "PYTHONPATH": str(sources), **environment},
        cwd=sources.parent,
        capture_output=True,
        text=True,
    )
    assert ran.returncode == 0, ran.stderr
    return ran.stdout.splitlines()


@pytest.mark.parametrize("committed", [True, False])
@pytest.mark.parametrize("place", ["third_party/arm", "."], ids=["in a folder", "at its top"])
def test_sources_in_a_repository_of_another_project(tmp_path: Path, place: str, committed: bool):
    theirs = tmp_path / "theirs"
    if not committed:
        repository(theirs)
    sources = sources_in(theirs / place)
    if committed:
        repository(theirs)
    # At the top of a repository that has them in its commit, they are that commit's.
    own = committed and place == "."
    head = git(theirs, "rev-parse", "HEAD")
    commit, last = told(sources)
    assert (head.startswith(commit), last == head) == (own, own)
    assert own or (commit, last) == ("unknown", "refused")


def test_checkouts_say_their_commit_and_whether_they_differ(tmp_path: Path):
    checkout = repository(sources_in(tmp_path / "with a space/arm"))
    git(checkout, "worktree", "add", "--detach", "../another tree")
    for tree in (checkout, tmp_path / "with a space/another tree"):
        head = git(tree, "rev-parse", "HEAD")
        commit, last = told(tree)
        assert head.startswith(commit) and last == head
        with (tree / "baselines/tools/provenance.py").open("a") as file:
            file.write("# edited\n")
        assert told(tree) == [f"{commit}-dirty", "refused"]


def test_without_a_repository_nothing_is_known(tmp_path: Path):
    assert told(sources_in(tmp_path / "arm")) == ["unknown", "refused"]


def test_the_repository_of_a_hook_that_runs_is_not_asked(tmp_path: Path):
    theirs, sources = repository(tmp_path / "theirs"), sources_in(tmp_path / "arm")
    assert told(sources, GIT_DIR=str(theirs / ".git")) == ["unknown", "refused"]
    own = git(repository(sources), "rev-parse", "HEAD")
    commit, last = told(sources, GIT_DIR=str(theirs / ".git"))
    assert own.startswith(commit) and last == own
