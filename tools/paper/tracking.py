"""Claims on the absolute position: section 3, and the claims of section 5 on the speed."""

import math
from collections.abc import Callable, Iterator

import numpy as np

from canfb import TrackResult, max_acceleration, track
from tools.paper.claim import Claim, Effort, grouped, verdict
from tools.paper.plant import CYCLES_PER_REVOLUTION, USUAL, Way, bisected, cycles_per_sample, followed, score

RATE_HZ = 25_000.0
SLOW_RATE_HZ = 1000.0
TOP_RPM = 2000.0
SERVO_RAD_S2 = 20_000.0
EQ_10_RAD_S2 = 785_398.16


def acceleration_limit(effort: Effort) -> Iterator[Claim]:
    """Claims on eq. 10, determined by experiment."""
    formula = max_acceleration(CYCLES_PER_REVOLUTION, RATE_HZ)
    found = largest_acceleration(is_right)
    measured = largest_acceleration(is_right, converted=True)
    yield Claim(
        "eq-10",
        f"{grouped(formula)} rad/s² by the formula, {grouped(found)} the largest that is tracked without "
        f"error; {grouped(measured)} with 12-bit converters and noise",
        verdict(abs(found / formula - 1.0) < 1e-4 and 0.99 < measured / formula < 1.0001),
    )
    slow = max_acceleration(CYCLES_PER_REVOLUTION, SLOW_RATE_HZ)
    needed_hz = math.sqrt(SERVO_RAD_S2 / max_acceleration(CYCLES_PER_REVOLUTION, 1.0, 1 / 3))
    yield Claim(
        "servo-machines",
        f"{formula / SERVO_RAD_S2:.0f} times below at 25 kHz. At 1 kHz the limit is {slow:.0f} rad/s² "
        f"({slow * 2 / 3:.0f} with 1/3): such a machine needs at least {needed_hz / 1e3:.1f} kHz",
        verdict(35 < formula / SERVO_RAD_S2 < 45 and 4800 < needed_hz < 5000),
    )


def long_runs(effort: Effort) -> Iterator[Claim]:
    """Claims at both sampling rates at +-2000 rpm, and on the count of revolutions."""
    usable = 0.95 * max_acceleration(CYCLES_PER_REVOLUTION, SLOW_RATE_HZ, 1 / 3)
    yield _long_run(
        "long-25khz", cycles_per_sample(TOP_RPM, RATE_HZ), acceleration_step(SERVO_RAD_S2, RATE_HZ), effort
    )
    yield _long_run(
        "long-1khz", cycles_per_sample(TOP_RPM, SLOW_RATE_HZ), acceleration_step(usable, SLOW_RATE_HZ), effort
    )
    yield revolutions(effort)
    yield _no_speed_limit()


def _long_run(key: str, top_speed: float, change: float, effort: Effort) -> Claim:
    rng = np.random.default_rng(1997)
    way = Way.random(effort.samples, top_speed, change, rng)
    got = score(way, followed(USUAL, way, rng))
    return Claim(
        key,
        f"{grouped(len(way))} samples, {grouped(way.reversals)} reversals, up to {way.top_speed:.2f} "
        f"cycles per sample, changing by up to {change:.2g} from sample to sample: {got.wrong} wrong cycle "
        f"counts, {got.flagged} flagged, largest error {100 * got.peak_error:.3f} % of a cycle (12 bits, "
        "noise)",
        verdict(got.wrong == 0 and got.flagged == 0 and 1e-4 < got.peak_error < 2e-3 and way.reversals > 20),
    )


def revolutions(effort: Effort) -> Claim:
    """Forward and back at 2000 rpm and 1 kHz: whole revolutions from the cycle count."""
    ramp = np.full(400, cycles_per_sample(TOP_RPM, SLOW_RATE_HZ) / 400)
    there = np.concatenate([[0.0], ramp, np.zeros(effort.samples // 2 - 801), -ramp])
    way = Way.from_steps(np.concatenate([there, -there]))
    result = followed(USUAL, way, np.random.default_rng(3))
    counted, true_count = (
        int(cycles.max()) // CYCLES_PER_REVOLUTION for cycles in (result.cycles, way.cycles)
    )
    back, moved = (int(cycles[-1] - cycles[0]) for cycles in (result.cycles, way.cycles))
    wrong = score(way, result).wrong  # a correct cycle implies a correct revolution
    return Claim(
        "revolutions",
        f"{grouped(counted)} revolutions forward and as many back at 2000 rpm and 1 kHz: {wrong} samples in "
        f"a wrong revolution, {back - moved} cycles left over",
        verdict(wrong == 0 and counted == true_count > 0 and back == moved),
    )


def _no_speed_limit() -> Claim:
    """Highest speed that a long acceleration within the limit can reach."""
    change, samples = 0.3, 350_000
    way = Way.from_steps(np.concatenate([[0.0], np.full(samples, change), np.zeros(1000)]))
    got = score(way, followed(USUAL, way, np.random.default_rng(5)))
    rpm = way.top_speed / CYCLES_PER_REVOLUTION * 60.0 * SLOW_RATE_HZ
    return Claim(
        "no-speed-limit",
        f"{grouped(way.top_speed)} cycles per sample ({grouped(rpm)} rpm at 1 kHz): {got.wrong} wrong cycle "
        f"counts, {got.flagged} flagged",
        verdict(got.wrong == 0 and got.flagged == 0 and way.top_speed > 1e5),
    )


def start_up(effort: Effort) -> Iterator[Claim]:
    """Claims on a start at standstill, in slow motion, in fast motion."""
    rng = np.random.default_rng(8)
    slow = rng.uniform(-0.499, 0.499, effort.cases)
    slow[: effort.cases // 10] = 0.0
    missed = [speed_error(v, rng.uniform()) for v in slow]
    wrong = sum(error != 0 for error, _ in missed)
    flags = sum(flagged for _, flagged in missed) / len(missed)
    yield Claim(
        "start-up",
        f"{wrong} of {len(slow)} starts up to ±0.499 cycle per sample wrong; {100 * flags:.0f} % flag their "
        "first step (beyond 1/3)",
        verdict(wrong == 0 and 0.2 < flags < 0.4),
    )
    fast = rng.uniform(0.501, 83.3, effort.cases) * rng.choice([-1.0, 1.0], effort.cases)
    missed = [speed_error(v, rng.uniform()) for v in fast]
    right = sum(error == 0 for error, _ in missed)
    # The count then follows the nearest alias, within half a cycle per sample.
    alias = sum(error == -round(v) for v, (error, _) in zip(fast, missed, strict=True))
    silent = sum(not flagged for _, flagged in missed) / len(missed)
    yield Claim(
        "start-up-too-fast",
        f"{right} of {len(fast)} starts up to ±83 cycles per sample right: the count runs on, slower by the "
        f"whole cycles per sample, and {100 * silent:.0f} % of these starts are never flagged",
        verdict(right == 0 and alias == len(fast) and 0.5 < silent < 0.8),
    )


def speed_error(speed: float, start: float) -> tuple[int, bool]:
    """Start at this constant speed: error of the speed, cycles per sample; whether anything was flagged."""
    position = start + speed * np.arange(50)
    whole = np.floor(position)
    result = track(position - whole)
    error = np.diff(result.cycles - result.cycles[0] - (whole - whole[0]))
    assert np.ptp(error) == 0
    return int(error[0]), not bool(result.ok.all())


def acceleration_step(rad_s2: float, rate_hz: float) -> float:
    """An acceleration as change of speed between samples, cycles per sample."""
    return rad_s2 * CYCLES_PER_REVOLUTION / (2.0 * math.pi) / rate_hz**2


def is_right(way: Way, result: TrackResult) -> bool:
    return bool(np.abs(way.error(result.cycles, result.phase)).max() < 0.5)


def largest_acceleration(good: Callable[[Way, TrackResult], bool], *, converted: bool = False) -> float:
    """By bisection, the largest constant acceleration at 25 kHz (rad/s²) that is `good`.

    Phases are exact, or (``converted``) of 12-bit converters with noise, corrected by an individual table.
    """

    def is_good(rad_s2: float) -> bool:
        change = acceleration_step(rad_s2, RATE_HZ)
        way = Way.from_steps(np.concatenate([[0.0, change / 2.0], np.full(1000, change)]))
        return good(way, followed(USUAL, way, np.random.default_rng(6)) if converted else track(way.phase))

    return bisected(0.0, 1.2 * EQ_10_RAD_S2, 1.0, is_good)
