import pytest
from module_bench import Bench


@pytest.fixture
def bench() -> Bench:
    made = Bench()
    made.start()
    return made
