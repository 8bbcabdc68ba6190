"""Every case of the list is a test or has a reason why not, for each device; the documentation agrees."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest
from case_list import CASES, GROUPS, TITLES, case_of, group_of
from conformance_kit import DEVICES, EDS, MODULE
from not_applicable import NOT_APPLICABLE

HERE = Path(__file__).parent
DOCUMENT = Path(__file__).parents[2] / "docs" / "conformance.md"


def cases_with_a_test() -> dict[str, set[str]]:
    """The cases with a test, by device: with the argument `tester` on all to which they apply."""
    found: dict[str, set[str]] = {device: set() for device in DEVICES}
    for path in sorted(HERE.glob("test_*.py")):
        for node in ast.parse(path.read_text()).body:
            case = case_of(node.name) if isinstance(node, ast.FunctionDef) else None
            if case is None or not isinstance(node, ast.FunctionDef):
                continue
            arguments = {argument.arg for argument in node.args.args}
            if "module" in arguments:
                found[MODULE].add(case)
            elif "tester" in arguments:
                for device in DEVICES:
                    if case not in NOT_APPLICABLE[device]:
                        found[device].add(case)
    return found


def test_the_list_is_whole() -> None:
    assert len(CASES) == sum(GROUPS.values()) == 127 + 24
    assert len(set(CASES)) == len(CASES)


@pytest.mark.parametrize("device", DEVICES)
def test_every_case_is_a_test_or_has_a_reason_why_not(device: str) -> None:
    tested, reasons = cases_with_a_test()[device], NOT_APPLICABLE[device].keys()
    assert set(CASES) - tested - reasons == set(), "neither tested nor explained"
    assert tested & reasons == set(), "tested although it does not apply"
    assert (tested | reasons) - set(CASES) == set(), "not in the list"


@pytest.mark.parametrize("device", DEVICES)
def test_the_reasons_hold(device: str) -> None:
    for case, reason in NOT_APPLICABLE[device].items():
        assert not any(EDS[device].has(*place) for place in reason.absent), f"{case} applies now"


def table() -> list[str]:
    """The table of the documentation: groups, what is passed by each device, what does not apply."""
    rows = ["| group | cases | module | encoder interface |", "|---|---:|---:|---:|"]
    tested = cases_with_a_test()
    for group, count in GROUPS.items():
        passed = [sum(group_of(case) == group for case in tested[device]) for device in DEVICES]
        rows.append(f"| {TITLES[group]} ({group}) | {count} | {passed[0]} | {passed[1]} |")
    total = [len(tested[device]) for device in DEVICES]
    rows.append(f"| **all** | **{len(CASES)}** | **{total[0]}** | **{total[1]}** |")
    return rows


def reasons() -> list[str]:
    """The list of the documentation: which cases do not apply to the encoder interface, and why."""
    by_reason: dict[str, list[str]] = {}
    for device in DEVICES:
        for case, reason in NOT_APPLICABLE[device].items():
            name = f"{group_of(case)} {case[-2:]}"
            by_reason.setdefault(f"{device}: {reason.why}", []).append(name)
    return [f"- {why}: {', '.join(sorted(names))}" for why, names in by_reason.items()]


def test_the_documentation_says_the_same() -> None:
    text = DOCUMENT.read_text().splitlines()
    missing = [line for line in table() + reasons() if line not in text]
    assert missing == [], "\n" + "\n".join([*table(), "", *reasons()])
