"""A test with the argument `tester` runs on each device that its case applies to."""

import pytest
from case_list import cases_of
from conformance_kit import DEVICES, MODULE, Tester, make_tester
from not_applicable import NOT_APPLICABLE
from test_exchange_cases import EXCHANGES


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    if "tester" not in metafunc.fixturenames or "module" in metafunc.fixturenames:
        return
    if "case" in metafunc.fixturenames:
        applicable = ((device, EXCHANGES.keys() - NOT_APPLICABLE[device].keys()) for device in DEVICES)
        table = sorted((device, case) for device, cases in applicable for case in cases)
        metafunc.parametrize(("tester", "case"), table, indirect=["tester"])
        return
    cases = {*cases_of(metafunc.function.__name__)}
    devices = [device for device in DEVICES if not cases & NOT_APPLICABLE[device].keys()]
    metafunc.parametrize("tester", devices, indirect=True)


@pytest.fixture
def tester(request: pytest.FixtureRequest) -> Tester:
    """A prepared device, in Pre-operational."""
    return make_tester(request.param).prepare()


@pytest.fixture
def module() -> Tester:
    """The drive feedback module alone, prepared."""
    return make_tester(MODULE).prepare()
