"""The cases of the list, by group, and how their numbers stand in the names of the tests."""

from __future__ import annotations

import re

GROUPS = {
    "EDS": 1, "SDO": 30, "PDO": 33, "OD": 9, "EMCY": 6, "SYNC": 10, "Guard": 6, "HB": 7, "HvG": 7,
    "Other": 10, "State": 4, "Trans": 4, "Beyond": 24,
}  # fmt: skip
CASES = [f"{group.lower()}_{number:02}" for group, count in GROUPS.items() for number in range(1, count + 1)]

_NAME = re.compile(
    rf"^test_({'|'.join(group.lower() for group in GROUPS)})_(\d\d)(?:_(to|and)_(\d\d))?(?:_|$)"
)


def cases_of(test_name: str) -> list[str]:
    """The cases that a test is named after (pdo_09_to_20, sdo_14_and_15); none: it tests something else."""
    match = _NAME.match(test_name)
    if match is None:
        return []
    group, first, joined, last = match.groups(default="")
    numbers = range(int(first), int(last) + 1) if joined == "to" else map(int, filter(None, (first, last)))
    return [f"{group}_{number:02}" for number in numbers]
