"""The lowest versions that pyproject.toml allows, as constraints for pip.

    python -m tools.suite.lowest > build/lowest.txt
    pip install --constraint build/lowest.txt --editable .

For what canfb needs to run, not for its tests.
"""

from __future__ import annotations

import re
import sys
import tomllib
from pathlib import Path

PROJECT = Path(__file__).parents[2] / "pyproject.toml"
BOUND = re.compile(r"(?P<name>[A-Za-z0-9._-]+)>=(?P<version>[0-9.]+)(?:,<[0-9.]+)?")


def constraints(text: str) -> list[str]:
    """`name==version` of each requirement; ValueError for one whose lower bound cannot be read."""
    project = tomllib.loads(text)["project"]
    found = []
    for requirement in project["dependencies"]:
        match = BOUND.fullmatch(requirement)
        if match is None:
            raise ValueError(f"{requirement!r}: write name>=version; the lowest version is tested")
        found.append(f"{match['name']}=={match['version']}")
    return found


if __name__ == "__main__":
    sys.stdout.write("\n".join(constraints(PROJECT.read_text(encoding="utf-8"))) + "\n")
