"""The cases of the list, by group, and how their numbers stand in the names of the tests."""

import re

GROUPS = {
    "EDS": 1, "SDO": 30, "PDO": 33, "OD": 9, "EMCY": 6, "SYNC": 10, "Guard": 6, "HB": 7, "HvG": 7,
    "Other": 10, "State": 4, "Trans": 4, "Beyond": 24,
}  # fmt: skip
CASES = [f"{group.lower()}_{number:02}" for group, count in GROUPS.items() for number in range(1, count + 1)]

_GROUP = "|".join(group.lower() for group in GROUPS)
_CASES = re.compile(rf"(?:^test|_and)_({_GROUP})_(\d\d)(?:_(to|and)_(\d\d))?(?=_|$)")


def cases_of(name: str) -> list[str]:
    """The cases that a test is named after (pdo_09_to_20, od_04_and_sdo_04); none: it tests another thing."""
    cases = []
    for group, first, joined, last in _CASES.findall(name):
        ends = int(first), int(last or first)
        numbers = range(ends[0], ends[1] + 1) if joined == "to" else sorted({*ends})
        cases += [f"{group}_{number:02}" for number in numbers]
    return cases
