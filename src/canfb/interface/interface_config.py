"""Parameters of one encoder interface."""

from __future__ import annotations

from dataclasses import dataclass

from canfb.checks import flag, integer_in, text, within
from canfb.device.lss import UNCONFIGURED
from canfb.signal.sample import MOST_PER_SYNC
from canfb.sources.protocol import SourceConfig


@dataclass(frozen=True, kw_only=True)
class InterfaceConfig:
    """One encoder interface: a node that sends the samples of its source, one PDO for each SYNC.

    node_id                  of the interface, 1..127, required; 255: none yet, an LSS master assigns one. A
                             node-ID stored by LSS in state_dir takes precedence
    source                   of its samples, required: a converter (``kind: iio``), a recording, or the
                             simulated machine
    serial_number            of the device, 0..4294967295 (1018:04): an LSS master distinguishes equal devices
                             by it
    times                    True: the ADC PDO carries the sample time after sine and cosine, as ``times`` of
                             the module expects it
    samples_per_sync         1..8 pairs of sine and cosine for each SYNC, with ``times`` at most 7, as
                             ``samples_per_sync`` of the module expects them
    adc_bits                 of the simulated converter, 4..16; those of a real one are its own, and another
                             number here is refused
    cycles_per_revolution    of the simulated encoder, 1..1048576
    state_dir                folder for the data of `save` (1010h) and LSS, created if missing; None: nothing
                             is saved
    autostart                True: OPERATIONAL without a master
    """

    node_id: int
    source: SourceConfig
    serial_number: int = 0
    times: bool = False
    samples_per_sync: int = 1
    adc_bits: int = 12
    cycles_per_revolution: int = 2500
    state_dir: str | None = None
    autostart: bool = False

    def __post_init__(self) -> None:
        if self.node_id != UNCONFIGURED or not isinstance(self.node_id, int):
            integer_in("node_id", self.node_id, 1, 127)
        if not isinstance(self.source, SourceConfig):
            raise ValueError(f"source must be a configuration of a source, not {self.source!r}")
        within(
            self,
            serial_number=(0, 0xFFFFFFFF),
            samples_per_sync=(1, MOST_PER_SYNC - bool(self.times)),
            adc_bits=(4, 16),
            cycles_per_revolution=(1, 1048576),
        )
        if self.state_dir is not None:
            text("state_dir", self.state_dir)
        for name in ("times", "autostart"):
            flag(name, getattr(self, name))
