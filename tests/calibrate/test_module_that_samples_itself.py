"""`canfb calibrate` for a module with a converter of its own: there is no ADC PDO on the bus."""

from __future__ import annotations

import json

import numpy as np
import pytest
from test_calibrate_on_a_bus import calibrate, position_errors

from canfb.cli.calibrate import choices_of
from canfb.cli.main import build_parser
from canfb.cli.node_options import nodes_of
from canfb.configuration import parse_config
from canfb.master.access import CommissioningError
from canfb.module.feedback_module import FeedbackModule
from canfb.module.module_config import ModuleConfig
from canfb.simulation.embedded_bus import EmbeddedBus
from canfb.simulation.sync_producer import SyncProducer
from commissioning_kit import CYCLES, MODULE_ID, RATE_HZ, Bench


class OwnConverter(Bench):
    """The bench with a module that asks the encoder itself, and nobody else on the bus."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.bus = EmbeddedBus()
        self.module = FeedbackModule(
            ModuleConfig(node_id=MODULE_ID, cycles_per_revolution=CYCLES, autostart=True), source=self.source
        )
        self.master = type(self.master)(self.bus)
        self.bus.attach(self.module)
        self.bus.attach(SyncProducer(1.0 / RATE_HZ))


def test_its_own_recording_calibrates_it(capsys: pytest.CaptureFixture[str]) -> None:
    bench = OwnConverter()
    bench.bus.run_until(0.5)
    before = position_errors(bench, 1000)
    assert calibrate(bench, "--source", "recording", "--recorder", "module", "--json") == 0
    assert json.loads(capsys.readouterr().out)["encoder_interface"] is None
    after = position_errors(bench, 1000)
    assert bench.value(0x2020, 4) != 0
    assert np.abs(after).max() < 0.2 * np.abs(before).max()


@pytest.mark.parametrize("source", ["pdo", "module"])
def test_without_an_adc_pdo_it_says_what_to_do(source: str) -> None:
    with pytest.raises(CommissioningError, match="--source recording --recorder module"):
        calibrate(OwnConverter(), "--source", source)


def test_the_configuration_of_such_a_module_names_no_encoder_interface() -> None:
    config = parse_config("modules: [{node_id: 16, source: {kind: motion}}]")
    options = build_parser().parse_args(["calibrate"])
    assert choices_of(options).nodes(nodes_of(config)) == (16, None)
