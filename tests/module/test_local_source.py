"""A module that samples itself: one sample of its source at each SYNC, whatever the source does."""

import math

import pytest
from module_bench import Bench

from canfb import FeedbackModule, ModuleConfig, Sample
from canfb.cia301.codes import NmtState
from canfb.signal.starts import START_SAMPLES
from canfb.signal.supervision import MISSED, VALID
from canfb.simulation.encoder import Encoder, Motion, MotionSource, Ramp, ShaftEncoder
from canfb.sources.motion_source import MotionSourceConfig
from canfb.sources.protocol import Source, SourceError
from folding import each
from ideal_tracks import counts_at
from played import repeated

PERIOD_S = 1e-3
UNITS_PER_CYCLE = 8192  # 6501h over 2500 cycles
RANGE_CYCLES = 209 * 2500  # 6002h


class Local(Bench):
    """A module with a source, in OPERATIONAL; what it says of the source."""

    def __init__(self, source: Source) -> None:
        super().__init__(source=source)
        self.told: list[str] = []
        self.module.on_source = self.told.append
        self.start()


def at(cycles: float, time_s: float | None = None) -> Sample:
    time = None if time_s is None else round(time_s * 1e7) & 0xFFFFFFFF
    return Sample(*counts_at(cycles), time_100ns=time)


def test_each_sync_brings_the_position_of_its_own_sample() -> None:
    motion = Motion((Ramp(0.1, 0.0), Ramp(0.5, 600.0)))
    source = MotionSource(ShaftEncoder(Encoder(noise_lsb=0.5), 2500), motion, PERIOD_S)
    local = Local(source)
    for _ in range(1500):
        units, status, _ = local.position(local.sync())
        assert status & VALID
        assert abs(math.remainder(units / UNITS_PER_CYCLE - source.position_cycles, RANGE_CYCLES)) < 0.01
    assert source.position_cycles > 10_000


WHOLE = Sample(100.4, -200.0, coarse_sine=7, coarse_cosine=-8, zero_pulse=0.25, time_100ns=2**32 + 5)
FIT = "does not fit INTEGER16"


@each("sample, objects", [
    (WHOLE, [100, -200, 7, -8, 5, 1, 16384]),
    (WHOLE._replace(invalid=True, zero_pulse=None, time_100ns=6), [100, -200, 7, -8, 6, 2, 0]),
    (Sample(32767.4, -32768.4, zero_pulse=0.0), [32767, -32768, 0, 0, 0, 1, 0]),
    (Sample(1, 2, zero_pulse=1.0), [1, 2, 0, 0, 0, 1, 65535]),
    (Sample(1, 2, coarse_sine=7, time_100ns=-1), [1, 2, 0, 0, 2**32 - 1, 0, 0]),
    (Sample(0, 0, elapsed=math.inf), "elapsed inf is not a number of intervals"),
    (Sample(0, 0, elapsed=0.0), "elapsed 0.0 is not a number of intervals"),
    (Sample(0, 0, elapsed=math.nan), "elapsed nan is not a number of intervals"),
    (Sample(0, 0, zero_pulse=1.01), "zero_pulse 1.01 is not a fraction of the interval"),
    (Sample(0, 0, zero_pulse=-0.01), "zero_pulse -0.01 is not a fraction of the interval"),
    (Sample(0, 0, coarse_sine=0, coarse_cosine=32768), f"coarse_cosine 32768 {FIT}"),
    *((Sample(n, 0), f"sine {n} {FIT}") for n in (32_768, -32_769, math.nan, math.inf)),
])  # fmt: skip
def test_a_sample_stands_in_2000h_or_is_a_failure(sample: Sample, objects: list[int] | str) -> None:
    local = Local(repeated(sample))
    local.sync()
    if isinstance(objects, str):
        assert local.told == [f"the source fails: {objects}"]
        assert local.sdo[0x2012][1].raw == 1
        objects = [0] * 7
    assert [local.sdo[0x2000][n].raw for n in range(1, 8)] == objects
    assert local.sdo[0x2012][7].raw == (objects[5] & 1), "zero pulses"


def test_a_sample_that_is_not_there_is_missed_and_the_tracker_steps_over_it() -> None:
    local = Local(repeated(*[None if n in (20, 21) else at(0.3 * n) for n in range(40)]))
    for n in range(40):
        units, status, _ = local.position(local.sync())
        assert bool(status & MISSED) == (n in (20, 21))
        assert units / UNITS_PER_CYCLE == pytest.approx(0.3 * n, abs=0.01)
    assert local.sdo[0x2012][1].raw == 2


FAILURES: list[Exception] = [SourceError("no such device"), OSError(19, "No device"), ZeroDivisionError()]


@pytest.mark.parametrize("error", FAILURES, ids=repr)
def test_a_source_that_fails_loses_the_position_and_says_so_once(error: Exception) -> None:
    good = at(0.1)
    local = Local(
        repeated(*[good] * 20, *[error] * 100, *(one for _ in range(50) for one in (good, error)), good)
    )
    frames = [frame for _ in range(220) for frame in local.sync()]
    assert len(local.told) == 1
    assert local.told[0].startswith("the source fails: ")
    status = local.sdo[0x2011][1].raw
    assert not status & VALID
    assert status & MISSED
    assert [frame for frame in frames if frame.can_id == 0x0A0], "an EMCY"
    assert local.module.state is NmtState.OPERATIONAL
    for count, told in ((990, []), (20, ["the source works again"])):
        for _ in range(count):
            local.sync()
        assert local.told[1:] == told


def test_sample_times_bridge_a_sync_that_came_late() -> None:
    """Each SYNC jitters by a tenth of the interval, and its sample with it."""
    late_s = [-1e-4, 0.0, 1e-4, 0.0, 5e-5, -5e-5, 0.0, 1e-4]
    times = [(n + 1) * PERIOD_S + late_s[n % 8] for n in range(200)]
    speed = 250.0  # cycles per second: 0.25 a sample, and 0.025 by the jitter
    local = Local(repeated(*[at(speed * time, time) for time in times]))
    for n, time in enumerate(times):
        local.interval_s = time - local.bus.now
        units, status, residual = local.position(local.sync())
        assert status & VALID or 0 < n < START_SAMPLES
        if n > 2:
            assert units / UNITS_PER_CYCLE == pytest.approx(speed * time, abs=0.01)
        if n > 4:  # the interval is known by now
            assert residual / 65536 < 0.03, "the tracks without a table; without the time it would be 0.07"
    assert local.sdo[0x2000][5].raw == round(times[-1] * 1e7)


def test_a_configured_source_must_be_given() -> None:
    with pytest.raises(ValueError, match="source="):
        FeedbackModule(ModuleConfig(node_id=32, source=MotionSourceConfig()))
