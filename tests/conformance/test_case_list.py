"""Every case of the list is a test or has a reason why not, for each device."""

import ast
from pathlib import Path

import pytest
from case_list import CASES, GROUPS, cases_of
from conformance_kit import DEVICES, EDS, MODULE
from not_applicable import NOT_APPLICABLE
from test_exchange_cases import EXCHANGES


def cases_with_a_test() -> dict[str, set[str]]:
    """The cases with a test, by device: with the argument `tester` on all to which they apply."""
    found = {device: EXCHANGES.keys() - NOT_APPLICABLE[device].keys() for device in DEVICES}
    for path in sorted(Path(__file__).parent.glob("test_*.py")):
        for node in ast.parse(path.read_text()).body:
            if not isinstance(node, ast.FunctionDef):
                continue
            cases, arguments = {*cases_of(node.name)}, {argument.arg for argument in node.args.args}
            if "module" in arguments:
                found[MODULE] |= cases
            elif "tester" in arguments:
                for device in DEVICES:
                    found[device] |= set() if cases & NOT_APPLICABLE[device].keys() else cases
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
