from pathlib import Path

import pytest
import sample_eds
from device_kit import Bench

from canfb.device.od.dictionary import Dictionary


@pytest.fixture(scope="session")
def sample_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return sample_eds.write(tmp_path_factory.mktemp("eds") / "sample.eds")


@pytest.fixture
def silent(sample_path: Path) -> Bench:
    """The sample device, not started."""
    return Bench(Dictionary.load(sample_path, 32))


@pytest.fixture
def bench(silent: Bench) -> Bench:
    """The sample device in PRE-OPERATIONAL."""
    silent.start()
    return silent
