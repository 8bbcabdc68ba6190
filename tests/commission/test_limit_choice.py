"""Limits from simulated machines: they hold, they detect, and they are near what the machine really does."""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from canfb import ChainConfig, max_acceleration, objects as od, process_stream
from canfb.calibrate.measurement import supervise
from canfb.commission.limit_choice import Choice, choose, observe
from canfb.commission.machine_figures import repeats_of_frozen_input
from canfb.master.access import CommissioningError
from canfb.master.samples import TrackSamples
from canfb.master.session import SupervisionLimits
from canfb.signal.phase import FloatArray
from canfb.simulation.encoder import Encoder, Motion, Ramp, Ripple
from folding import each
from machine_kit import RATE_HZ, N, SimulatedMachine, duty

GOOD = Encoder(noise_lsb=0.5)
COUNT = 6000
MACHINES = {
    "quiet": SimulatedMachine(duty(120, 0.5), GOOD),
    "fast": SimulatedMachine(duty(2000, 0.9), GOOD),
    "noisy converter of 10 bits": SimulatedMachine(
        duty(120, 0.5), Encoder(amplitude_counts=380, adc_bits=10, noise_lsb=1.5)
    ),
    "vibrating": SimulatedMachine(duty(300, 0.5, ripples=(Ripple(0.8, 130.0),)), GOOD),
    "converter without noise": SimulatedMachine(duty(120, 0.5), Encoder()),
    "whole cycles per sample, no noise": SimulatedMachine(
        Motion((Ramp(0.5, 24.0), Ramp(0.3, 120.0), Ramp(0.6, 120.0)) * 200, (), 24.0), Encoder()
    ),
    "amplitude over the revolution": SimulatedMachine(duty(600, 0.5), GOOD, modulation=0.12),
    "jitter": SimulatedMachine(duty(300, 0.5), GOOD, jitter_s=1e-6),
}


def fresh(name: str) -> SimulatedMachine:
    """The machine at its start, with its noise."""
    return replace(MACHINES[name], rng=np.random.default_rng(4))


def config_of(machine: SimulatedMachine, limits: SupervisionLimits) -> ChainConfig:
    """The same limits for the chain over arrays."""
    chain = limits.chain_limits(1.0 / RATE_HZ)
    return ChainConfig(
        adc_bits=machine.encoder.adc_bits,
        amplitude_low_counts=int(chain.sample.amplitude_low_counts),
        amplitude_high_counts=int(chain.sample.amplitude_high_counts),
        residual_limit=chain.residual_limit,
        frozen_samples=chain.frozen_samples,
    )


def flagged(
    machine: SimulatedMachine, limits: SupervisionLimits, samples: TrackSamples, speed: float
) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    """Which samples were not published as valid."""
    blocks = [(samples.sine, samples.cosine)]
    (found,) = process_stream(blocks, config_of(machine, limits), machine.used.table, speed)
    return ~found.valid


@pytest.mark.parametrize("name", MACHINES)
def test_the_limits_are_near_the_truth_detect_glitches_and_hold_on_ten_times_more_data(name: str) -> None:
    machine = fresh(name)
    observed, new, choices = machine.commissioned(COUNT)
    truth = machine.motion.revolutions_at(np.arange(COUNT) / RATE_HZ) * N
    true = float(np.abs(np.diff(truth, 2)).max())
    noise = (
        math.sqrt(machine.encoder.noise_lsb**2 + 1.0 / 12.0) / machine.encoder.amplitude_counts / 2 / math.pi
    )
    motion = observed.motion
    low = 0.75 if name in ("vibrating", "jitter") else 0.95
    high = 2.5 if name == "jitter" else 1.05
    assert low * true <= motion.acceleration <= high * true
    assert motion.jerk <= high * np.abs(np.diff(truth, 3)).max()
    if name not in ("vibrating", "jitter"):  # which disturb the phase as noise does
        assert 0.5 * noise < motion.noise < 1.5 * noise
    limit = choices[od.SUPERVISION_RESIDUAL_LIMIT].value / 65536
    assert limit >= max(0.02, 2.0 * true + 6.0 * math.sqrt(6.0) * motion.noise) or limit == 21845 / 65536
    assert limit <= max(0.0201, 2.0 * (true + 20.0 * motion.noise) + 0.001) or name == "jitter"
    largest = new.chain_limits(1.0 / RATE_HZ).acceleration or 0.0
    assert largest >= 0.95 * 2.0 * low * true
    assert largest <= max(2.1 * high * true, limit - 0.049)
    assert choices[od.SUPERVISION_ACCELERATION].value <= max_acceleration(N, RATE_HZ) * (1 + 1e-6)
    times = machine.start_s + np.array([0.0, 1e-6])
    cycles_per_interval = float(np.diff(machine.motion.revolutions_at(times))[0]) / 1e-6 * N / RATE_HZ
    # L + a of the machine itself, and what noise may take off.
    position = machine.positions(COUNT)
    true = float(np.abs(np.diff(position, 2)).max())
    size = 2 * math.pi * machine.encoder.amplitude_counts
    least = new.chain_limits(1.0 / RATE_HZ).residual_limit + true
    least += 8.0 * math.sqrt(6.0) * (machine.encoder.noise_lsb + 0.3) / size
    if least < 0.5:
        rng = np.random.default_rng(8)
        places = np.arange(60, COUNT - 60, 60)
        glitch = np.zeros(COUNT)
        glitch[places] = rng.uniform(least, 1.0 - least, len(places))
        samples = TrackSamples.of(*machine.counts(position + glitch), RATE_HZ, "with glitches")
        found = flagged(machine, new, samples, cycles_per_interval)
        assert all(found[place] or found[place + 1] for place in places)
    assert not flagged(machine, new, machine.samples(10 * COUNT), cycles_per_interval).any()


@each("noise_lsb, words", [(0.5, "/s², times 2"), (20.0, "raised: a smaller one would narrow the residual")])
def test_the_words_say_which_acceleration_is_proposed(noise_lsb: float, words: str) -> None:
    machine = SimulatedMachine(duty(1, 0.5), Encoder(noise_lsb=noise_lsb))
    observed, _, choices = machine.commissioned(COUNT)
    choice, seen = choices[od.SUPERVISION_ACCELERATION], observed.rad(observed.motion.acceleration, 2, N)
    assert words in choice.why
    assert ("times 2" in choice.why) == (choice.value == pytest.approx(2.0 * seen, rel=0.02))


def test_amplitude_limits_and_frozen_input() -> None:
    machine = fresh("quiet")
    _, _, choices = machine.commissioned(COUNT)
    assert choices[od.ENCODER_LOWEST_AMPLITUDE].value == pytest.approx(0.8 * 1500, abs=2)
    assert choices[od.ENCODER_HIGHEST_AMPLITUDE].value == pytest.approx(1.2 * 1500, abs=2)
    assert 16 <= choices[od.SUPERVISION_FROZEN].value <= 80
    _, _, choices = fresh("amplitude over the revolution").commissioned(COUNT)
    assert 1050 < choices[od.ENCODER_LOWEST_AMPLITUDE].value < 1500 * (1 - 2 * 0.118)
    assert 1500 * (1 + 2 * 0.118) < choices[od.ENCODER_HIGHEST_AMPLITUDE].value < 1950
    for name in ("converter without noise", "whole cycles per sample, no noise"):
        _, _, choices = fresh(name).commissioned(COUNT)
        assert choices[od.SUPERVISION_FROZEN].value == 0, "its counts repeat themselves, and it works"
        assert choices[od.SUPERVISION_FROZEN].why.startswith("off: ")


@pytest.mark.parametrize("noise", [0.4, 0.5, 0.8, 1.5])
def test_frozen_repeats_come_true_in_the_worst_case(noise: float) -> None:
    """Both tracks in the middle of a count: repeats as long as the formula says, scaled to a short time."""
    rng = np.random.default_rng(1)
    samples = 400_000
    same = np.all(np.diff(np.rint(rng.normal(0.0, noise, (samples, 2))), axis=0) == 0.0, axis=1)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], same.astype(int), [0]])))
    longest = int((edges[1::2] - edges[::2]).max())
    rate_hz = samples / (10.0 * 365.25 * 86400.0)  # so that ten years have as many samples
    repeats = repeats_of_frozen_input(noise, rate_hz, 2.0, 0)
    assert longest < repeats or repeats == 0
    assert repeats_of_frozen_input(noise, 1000.0, 2.0, 0) >= repeats
    assert repeats_of_frozen_input(noise, 1000.0, 2.0, 200) == 0, "more than seen, or off"


def test_a_machine_that_never_stops_or_is_slow_keeps_what_it_does_not_show() -> None:
    machine = SimulatedMachine(Motion((), (Ripple(12, 0.31), Ripple(6, 1.7)), 600.0), GOOD)
    _, _, choices = machine.commissioned(COUNT)
    for place in (od.SUPERVISION_RESIDUAL_LIMIT, od.SUPERVISION_ACCELERATION):
        assert not choices[place].changes
        assert "--acceleration" in choices[place].why
    assert choices[od.ENCODER_LOWEST_AMPLITUDE].changes
    _, new, choices = machine.commissioned(COUNT, known=50.0)
    assert choices[od.SUPERVISION_ACCELERATION].value == pytest.approx(50.0, rel=0.01)
    limit = new.chain_limits(1.0 / RATE_HZ).residual_limit
    assert 50.0 * N / 2 / math.pi / 1e6 < limit < 0.03
    _, _, choices = SimulatedMachine(duty(2.0, 0.5), GOOD).commissioned(COUNT)
    assert not choices[od.SUPERVISION_PHASE_ERROR].changes
    assert choices[od.SUPERVISION_RESIDUAL_LIMIT].value >= 4 * choices[od.SUPERVISION_PHASE_ERROR].value


@each(
    "cycles, starts", [(1.38, True), (12.9, True), (20.0, True), (62.5, True), (20.0, False), (62.5, False)]
)
def test_the_phase_error_is_the_whole_one_at_any_speed(cycles: float, starts: bool) -> None:
    """An offset of 0.1 is 0.016 cycle; of a machine that turns evenly from the start on it is not known."""
    rpm = 60.0 * cycles * RATE_HZ / N
    machine = SimulatedMachine(Motion((Ramp(2.3, rpm), Ramp(9.0, rpm)), (), 0.0 if starts else rpm), GOOD)
    choice = choice_of(machine, od.SUPERVISION_PHASE_ERROR, lambda one: replace(one, sine=one.sine + 150.0))
    error = math.asin(0.1) / (2.0 * math.pi)
    assert not choice.changes or 0.97 * error <= choice.value / 65536 / 2.0 <= 1.15 * error
    assert choice.changes == starts
    assert starts or "only a few phases" in choice.why


def test_a_larger_margin_gives_wider_limits() -> None:
    limits = [fresh("fast").commissioned(COUNT, margin)[1] for margin in (1.2, 2.0, 3.0)]
    residual = [one.chain_limits(1.0 / RATE_HZ).residual_limit for one in limits]
    assert residual == sorted(residual)
    assert residual[0] < residual[1] < residual[2]


Changed = Callable[[TrackSamples], TrackSamples]


def choice_of(machine: SimulatedMachine, place: od.Multiplexer, change: Changed) -> Choice:
    """What is proposed for a limit where the samples are changed like this."""
    readings, samples = machine.readings(COUNT), machine.samples(COUNT)
    observed = observe(change(samples), machine.used, machine.limits, readings)
    return next(one for one in choose(observed, machine.limits, 2.0) if one.place == place)


def noise(seed: int) -> FloatArray:
    return np.random.default_rng(seed).uniform(-1500, 1500, COUNT)


def few(n: int, one: TrackSamples) -> TrackSamples:
    return TrackSamples.of(one.sine[:n], one.cosine[:n], RATE_HZ, "few")


def unheard(one: TrackSamples) -> TrackSamples:
    heard = np.arange(len(one)) % 300 < 299
    samples = TrackSamples.of(one.sine[heard], one.cosine[heard], RATE_HZ, "of a busy computer")
    return replace(samples, received_s=np.flatnonzero(heard) / RATE_HZ)


@each("change, said, message", [
    *((partial(few, n), True, f"{n} usable samples of {n} are too few") for n in (1, 1500)),
    (lambda one: one, False, "did not report its speed"),
    (lambda one: replace(one, rate_hz=None), True, "rate of the samples is not known"),
    (lambda one: replace(one, sine=np.nan * one.sine), True, "samples missed"),
    (lambda one: TrackSamples.of(noise(1), noise(2), RATE_HZ, "noise"), True, "position is lost"),
    (unheard, True, r"position is lost .* did not receive about \d+ SYNCs\)"),
    (lambda one: replace(one, sine=0.2 * one.sine, cosine=0.2 * one.cosine), True, "amplitude"),
    (lambda one: replace(one, sine=one.sine + np.linspace(0.0, 120.0, COUNT)), True, "the tracks change"),
])  # fmt: skip
def test_what_says_too_little_is_refused(change: Changed, said: bool, message: str) -> None:
    machine = fresh("quiet")
    readings, samples = machine.readings(COUNT), machine.samples(COUNT)
    with pytest.raises(CommissioningError, match=message) as error:
        observe(change(samples), machine.used, machine.limits, readings if said else [])
    assert "\n" not in str(error.value)


def test_the_whole_cycles_per_sample_come_from_the_readings() -> None:
    """A machine that turns already, at 83 cycles per sample."""
    machine = SimulatedMachine(Motion((Ramp(1.0, 2000.0), Ramp(1.5, 2000.0), Ramp(1.0, 900.0)) * 9), GOOD)
    machine.start_s = 1.7
    observed = machine.observed(3000)
    assert observed.start_speed == pytest.approx(2000 / 60 * N / RATE_HZ, abs=0.01)
    assert observed.motion.fastest == pytest.approx(2000 / 60 * N / RATE_HZ, abs=0.1)


def test_the_account_of_the_chain_is_that_of_the_stream() -> None:
    machine = fresh("fast")
    samples = machine.samples(3000)
    found = supervise(samples, machine.used, machine.limits.chain_limits(1.0 / RATE_HZ), 0.0)
    config = config_of(machine, machine.limits)
    (other,) = process_stream([(samples.sine, samples.cosine)], config, machine.used.table, 0.0)
    assert np.array_equal(found.status, other.status)
    origin = other.cycles[0]
    assert np.array_equal(found.position, (other.cycles - origin) + other.phase)


@each("off_s, least_s, most_s, why", [
    (0.0, 0.0, 0.0, "default"),
    (9e-5, 0.0, 0.0, "default"),
    (1.5e-4, 2.8e-4, 3.0e-4, "times 2"),
    (3e-4, 0.0, 0.0, "find its cause"),
])  # fmt: skip
def test_the_jitter_of_the_sync_is_measured(off_s: float, least_s: float, most_s: float, why: str) -> None:
    """One SYNC in a hundred comes late by this time."""
    machine = fresh("quiet")
    times = np.arange(COUNT) / RATE_HZ + np.where(np.arange(COUNT) % 100 == 50, off_s, 0.0)
    choice = choice_of(machine, od.SUPERVISION_SYNC_JITTER, lambda one: replace(one, received_s=times))
    assert least_s <= choice.value <= most_s
    assert why in choice.why


@each("counts, stated", [(0.0, 0.0), (20.0, 0.0015)])
def test_tracks_that_change_are_stated(counts: float, stated: float) -> None:
    """An offset that drifts: counts / amplitude / 2 pi / sqrt 2 rms, two thirds of it from third to third."""
    machine = fresh("quiet")
    readings, samples = machine.readings(COUNT), machine.samples(COUNT)
    samples = replace(samples, sine=samples.sine + np.linspace(0.0, counts, COUNT))
    found = observe(samples, machine.used, machine.limits, readings).motion.change
    assert found == pytest.approx(stated, rel=0.4)


RANGE = 0.02
"""Of the error of the coarse track, revolutions."""


@each(
    "motion, size, low, high, why",
    [
        (duty(120, 0.5), 1500.0, 1.95 * RANGE, 2.15 * RANGE, "° of the shaft"),
        (duty(10, 0.3), 1500.0, 2048 / 65536, 2048 / 65536, "less than a revolution"),
        (duty(120, 0.5), 100.0, 2048 / 65536, 2048 / 65536, "no amplitude"),
    ],
)
def test_the_limit_is_the_range_of_the_error_times_the_margin(
    motion: Motion, size: float, low: float, high: float, why: str
) -> None:
    """An error of two waves per revolution."""
    revolutions = motion.revolutions_at(np.arange(COUNT) / RATE_HZ)
    angle = 2 * np.pi * (revolutions + 0.3 + RANGE / 2 * np.sin(4 * np.pi * revolutions))
    coarse = np.rint(size * np.sin(angle)), np.rint(size * np.cos(angle))
    machine = SimulatedMachine(motion, GOOD)
    choice = choice_of(machine, od.SUPERVISION_COARSE_LIMIT, lambda one: replace(one, coarse=coarse))
    assert low <= choice.value / 65536 <= high
    assert why in choice.why
