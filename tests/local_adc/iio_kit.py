"""What several of the tests with an emulated ADC need."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from functools import partial

import numpy as np
from emulated_iiod import EmulatedIiod

from canfb.hosting.captured_source import REOPEN_S, CapturedSource
from canfb.signal.sample import Sample
from canfb.simulation.encoder import Encoder
from canfb.simulation.motion import Motion, Ramp
from canfb.simulation.scenario import SimulationConfig
from canfb.sources.iio_source import IioSourceConfig
from canfb.sources.protocol import Surroundings

LIMIT_S = 60.0  # for what takes milliseconds, or a second


def until(happened: Callable[[], bool], what: str) -> None:
    """Wait for what another thread does."""
    end = time.monotonic() + LIMIT_S
    while not happened():
        assert time.monotonic() < end, f"not {what} within {LIMIT_S:g} s"
        time.sleep(0.001)


def iio_source(config: IioSourceConfig, reopen_s: float = REOPEN_S) -> CapturedSource:
    """The source of this configuration; what opens it closes it."""
    with contextlib.ExitStack() as resources:
        source = config.open(
            Surroundings(12, 2500, SimulationConfig, partial(CapturedSource, reopen_s=reopen_s), resources)
        )
    assert isinstance(source, CapturedSource)
    return source


def reading(sine: int, cosine: int, time_ns: int = 0) -> dict[str, int]:
    return {"voltage0": sine, "voltage1": cosine, "voltage2": 77, "timestamp": time_ns}


def deliver(server: EmulatedIiod, source: CapturedSource, *scans: dict[str, int]) -> None:
    """Scans that have come before the next SYNC."""
    wanted = source.scans + len(scans)
    server.deliver(*scans)
    until(lambda: source.scans == wanted, "delivered")


class Machine:
    """An encoder on a machine that is scanned at even times; where it was at each scan, in cycles."""

    def __init__(self, scan_s: float, *ramps: Ramp) -> None:
        self.scan_s = scan_s
        self.truth_cycles: list[float] = []
        self._motion, self._encoder = Motion(ramps), Encoder(noise_lsb=0.5)
        self._rng = np.random.default_rng(11)

    def scan(self) -> dict[str, int]:
        """The next one."""
        time_s = len(self.truth_cycles) * self.scan_s
        self.truth_cycles.append(self._motion.revolutions(time_s) * 2500)
        sine, cosine = self._encoder.sample(self.truth_cycles[-1], self._rng)
        return reading(int(sine) + 2048, int(cosine) + 2048, round(time_s * 1e9))

    def scans_until(self, until_s: float) -> list[dict[str, int]]:
        """Those that are due."""
        found = []
        while len(self.truth_cycles) * self.scan_s <= until_s:
            found.append(self.scan())
        return found


def sample(sine: int, cosine: int, time_100ns: int | None) -> Sample:
    return Sample(sine, cosine, time_100ns=time_100ns)


def fired_by_sync(server: EmulatedIiod) -> str:
    """The source of a configuration: an ADC that samples when its trigger is fired."""
    place = f"uri: 'ip:127.0.0.1:{server.port}', device: ads7950"
    return f"{{kind: iio, {place}, trigger: sysfstrig7, wait_us: 1000000}}"
