"""One measurement, calculated once: many tests only need that there is one."""

import json
from typing import Any

import pytest
from calibrating import calibrate

from canfb.calibrate.measurement import Measurement, Settings, measure
from canfb.master.samples import TrackSamples
from canfb.signal.conditioning import Conditioning
from canfb.signal.correction import Correction
from commissioning_kit import random_encoder, recorded
from ideal_tracks import wavy_table


@pytest.fixture(scope="session")
def settings() -> Settings:
    return Settings(entries=64, adc_bits=12)


@pytest.fixture(scope="session")
def samples() -> TrackSamples:
    return recorded(random_encoder(3), 3000)


@pytest.fixture(scope="session")
def fresh() -> TrackSamples:
    """The same encoder, a minute later."""
    return recorded(random_encoder(3), 1500, start_s=60.0, seed=9)


@pytest.fixture(scope="session")
def old() -> Correction:
    """What was active before: some other table and conditioning."""
    return Correction(wavy_table(32), Conditioning(4.0, -2.5, 1.0, 0.984375, 0.0078125))


@pytest.fixture(scope="session")
def measured(samples: TrackSamples, old: Correction, settings: Settings) -> Measurement:
    return measure(samples, settings, old, lambda part: None)


@pytest.fixture
def figures_of(capsys: pytest.CaptureFixture[str]) -> Any:
    """figures_of(bench, "--save"): what `canfb calibrate --json` says of it."""

    def run(bench: Any, *arguments: str, act: Any = calibrate, **words: Any) -> Any:
        capsys.readouterr()
        assert act(bench, *arguments, "--json", **words) == 0
        return json.loads(capsys.readouterr().out)

    return run
