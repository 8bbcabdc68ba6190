"""The feedback module that a simulation feeds, as far as the simulation must know it."""

from __future__ import annotations

from dataclasses import dataclass

from canfb.device.lss import UNCONFIGURED
from canfb.signal.chain_config import ChainConfig


@dataclass(frozen=True, kw_only=True)
class FedModule:
    """A module and its encoder interface.

    chain                       its encoder, converter and residual limit
    node_id                     1..127; 255: none yet
    encoder_interface           node-ID of the interface that is simulated
    times                       the ADC PDO carries the sample time
    samples_per_sync            1..4 pairs of sine and cosine for each SYNC
    autostart                   operational without a master
    increments_per_revolution   scale of its position (6001h)
    total_range                 where its position wraps (6002h)
    """

    chain: ChainConfig
    node_id: int
    encoder_interface: int
    times: bool
    samples_per_sync: int
    autostart: bool
    increments_per_revolution: int
    total_range: int

    @property
    def has_node_id(self) -> bool:
        """No LSS master has to give it one."""
        return self.node_id != UNCONFIGURED
