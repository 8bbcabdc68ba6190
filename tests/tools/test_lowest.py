"""tools/suite/lowest.py: lower bounds as constraints, and pyproject.toml has one for each requirement."""

from __future__ import annotations

import pytest

from tools.suite import lowest

TEXT = """
[project]
dependencies = ["one>=1.2", "two-three>=4.5.6,<7"]
optional-dependencies = {test = ["four"]}
"""


def test_each_lower_bound_becomes_the_version() -> None:
    assert lowest.constraints(TEXT) == ["one==1.2", "two-three==4.5.6"]


@pytest.mark.parametrize("requirement", ["one", "one==1.2", "one<2", "one[extra]>=1"])
def test_a_requirement_without_a_lower_bound_is_a_mistake(requirement: str) -> None:
    with pytest.raises(ValueError, match="write name>=version"):
        lowest.constraints(TEXT.replace("one>=1.2", requirement))


def test_every_requirement_of_the_project_has_one() -> None:
    found = lowest.constraints(lowest.PROJECT.read_text(encoding="utf-8"))
    assert {line.partition("==")[0] for line in found} >= {
        "numpy",
        "python-can",
        "canopen",
        "pyyaml",
        "msgpack",
    }
