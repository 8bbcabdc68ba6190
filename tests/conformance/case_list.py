"""The cases of the list, by group, and how their numbers stand in the names of the tests."""

from __future__ import annotations

import re

GROUPS = {
    "EDS": 1,
    "SDO": 30,
    "PDO": 33,
    "OD": 9,
    "EMCY": 6,
    "SYNC": 10,
    "Guard": 6,
    "HB": 7,
    "HvG": 7,
    "Other": 10,
    "State": 4,
    "Trans": 4,
    "Beyond": 24,
}
CASES = [f"{group.lower()}_{number:02}" for group, count in GROUPS.items() for number in range(1, count + 1)]

_NAME = re.compile(rf"^test_((?:{'|'.join(group.lower() for group in GROUPS)})_\d\d)(?:_|$)")


def case_of(test_name: str) -> str | None:
    """The case that a test is named after, None for a test of something else."""
    match = _NAME.match(test_name)
    return match[1] if match else None
