"""Print the lowest version that pyproject.toml allows of each package that it names, for pip."""

import re
import tomllib
from collections.abc import Iterator
from itertools import chain
from pathlib import Path

PROJECT = Path(__file__).resolve().parent.parent / "pyproject.toml"


def lowest_versions() -> Iterator[str]:
    project = tomllib.loads(PROJECT.read_text(encoding="utf-8"))["project"]
    for requirement in chain(project["dependencies"], *project["optional-dependencies"].values()):
        stated = re.fullmatch(r"([\w-]+)(?:\[.+\])?[>=]=([\w.]+)(,.+)?", requirement)
        if stated:
            yield f"{stated[1]}=={stated[2]}"
        elif not requirement.startswith(f"{project['name']}["):
            raise ValueError(f"{requirement!r} in {PROJECT.name} states no lowest version: NAME>=VERSION")


if __name__ == "__main__":
    print(*sorted(set(lowest_versions())), sep="\n")
