"""A module and its encoder interface in simulated time, on a virtual bus: to look at a page without a bus."""

from __future__ import annotations

import struct
from uuid import uuid4

from canfb import objects as od
from canfb.bus.trying import NetworkOnBus
from canfb.cia301 import cob
from canfb.cia301.frame import Frame
from canfb.configuration import Config
from canfb.module.module_config import ModuleConfig
from canfb.simulation.scenario import EncoderScenario, HarmonicConfig, MotionConfig, SimulationConfig

NODE, RATE_HZ = 0x20, 200.0
# A mediocre encoder, on a machine whose speed varies.
ENCODER = EncoderScenario(
    amplitude=0.73,
    sine_offset=0.04,
    cosine_offset=-0.03,
    sine_amplitude=1.03,
    cosine_amplitude=0.96,
    phase_error_rad=0.05,
    harmonics=[HarmonicConfig(order=3, sine=0.012, cosine=0.01)],
)
SIMULATION = SimulationConfig(encoder=ENCODER, motion=MotionConfig(rpm=60.0, ripple_rpm=3.0, ripple_hz=0.15))


# TPDO3 carries the velocity at each sample: seen from outside it would have the jitter of this computer.
TPDO3, MAPPING = od.TPDO + 2, od.TPDO_MAPPING + 2
BYTE, LONG = 0x2F, 0x23  # expedited downloads (CiA 301, 7.2.4.3.3)
MAPPED = (
    (LONG, MAPPING, 1, 0x20110720),
    (BYTE, MAPPING, 0, 1),
    (BYTE, TPDO3, 2, 254),
    (LONG, TPDO3, 1, cob.TPDO3 + NODE),
)
DOWNLOAD = struct.Struct("<BHBI")


class ScopeDemo(NetworkOnBus):
    """Runs in a thread while it is entered; ``words`` are python-can's for its bus."""

    def __init__(self) -> None:
        words = {"interface": "virtual", "channel": f"canfb scope {uuid4()}"}
        module = ModuleConfig(node_id=NODE, autostart=True)
        first = [Frame(cob.SDO_REQUEST + NODE, DOWNLOAD.pack(*download)) for download in MAPPED]
        super().__init__(Config(words, [module], simulation=SIMULATION), RATE_HZ, first=first)
