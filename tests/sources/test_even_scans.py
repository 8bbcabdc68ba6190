"""Scans on a grid that is locked to SYNC: equidistant samples, whatever the SYNC and the program do."""

import itertools
import random
from collections.abc import Iterable, Sequence

import pytest

from canfb.signal.sample import Sample
from canfb.sources.protocol import EvenScans, NewestScan, SourceError

TICKS_PER_S = 10_000_000
SYNC_S = 1e-3


class Bench:
    """A converter that scans every ``scan_s`` seconds, and SYNCs; the sine is the number of the scan."""

    def __init__(self, per_sync: int, scans: int, scan_s: float, lost: Iterable[int] = ()) -> None:
        self.picked = EvenScans(per_sync, scans)
        self._scan_s, self._next, self._lost = scan_s, 0, set(lost)
        self.told: list[str] = []

    def scan_until(self, now: float) -> None:
        while self._next * self._scan_s <= now:
            if self._next not in self._lost:
                time = round(self._next * self._scan_s * TICKS_PER_S) % 2**32
                self.picked.came(Sample(self._next, -self._next, time_100ns=time))
            self._next += 1

    def sync(self, heard_s: float) -> Sample | None:
        self.scan_until(heard_s)
        try:
            return self.picked.take()
        except SourceError as error:
            self.told.append(str(error))
            return None

    def run(self, heard_s: Sequence[float]) -> list[Sample | None]:
        return [self.sync(time) for time in heard_s]


def numbers(samples: Iterable[Sample | None]) -> list[list[int]]:
    """Of each sample the scans, the newest first."""
    return [[int(one.sine), *(int(sine) for sine, _ in one.earlier)] for one in samples if one is not None]


def even(count: int, jitter_s: float = 0.0) -> list[float]:
    rng = random.Random(3)
    return [n * SYNC_S + rng.uniform(0.0, jitter_s) for n in range(1, count + 1)]


@pytest.mark.parametrize(("per_sync", "scans"), [(1, 8), (2, 2), (2, 8), (3, 6), (4, 8), (4, 64)])
def test_samples_are_equidistant_however_the_sync_jitters(per_sync: int, scans: int) -> None:
    bench = Bench(per_sync, scans, SYNC_S / scans)
    samples = bench.run(even(500, jitter_s=0.4 * SYNC_S))
    chosen = numbers(samples)
    assert len(chosen) >= 496
    newest = [(one.time_100ns, round(one.sine * SYNC_S / scans * TICKS_PER_S)) for one in samples if one]
    assert all(time_100ns == true for time_100ns, true in newest)
    apart = scans // per_sync
    assert all(one == [one[0] - n * apart for n in range(per_sync)] for one in chosen)
    steps = [after[0] - before[0] for before, after in itertools.pairwise(chosen)]
    moved = [step for step in steps if step != scans]
    assert len(moved) < 12, "the grid stands"
    assert sum(steps) == pytest.approx(scans * len(steps), abs=scans)


@pytest.mark.parametrize("drift", [200e-6, -200e-6])
def test_the_grid_follows_the_drift_of_the_clock_by_single_scans(drift: float) -> None:
    bench = Bench(2, 8, SYNC_S / 8 * (1.0 + drift))
    samples = bench.run(even(20_000, jitter_s=50e-6))
    chosen = numbers(samples)
    assert len(chosen) >= 19_995
    steps = [after[0] - before[0] for before, after in itertools.pairwise(chosen)]
    moved = [step - 8 for step in steps if step != 8]
    assert set(moved) == ({-1} if drift > 0 else {1})
    assert len(moved) == pytest.approx(8 * 20_000 * abs(drift), abs=4)


def test_a_sync_too_soon_has_no_sample_and_the_grid_stands() -> None:
    bench = Bench(2, 8, SYNC_S / 8)
    before = numbers(bench.run(even(60)))
    assert bench.sync(60 * SYNC_S + 0.2 * SYNC_S) is None
    (after,) = numbers([bench.sync(61 * SYNC_S)])
    assert after[0] - before[-1][0] == 8


def test_after_a_stall_the_grid_stands_and_the_syncs_of_the_burst_have_no_sample() -> None:
    """The program stands still for five intervals, and then hears five SYNCs at once."""
    bench = Bench(2, 8, SYNC_S / 8)
    heard = even(120)
    heard[60:65] = [heard[64] + 1e-5 * n for n in range(5)]
    samples = bench.run(heard)
    assert [n for n, one in enumerate(samples) if one is None and n > 10] == [61, 62, 63, 64]
    chosen = numbers(samples)
    steps = {after[0] - before[0] for before, after in itertools.pairwise(chosen)}
    assert steps == {8, 40}


def test_scans_that_are_lost_make_no_sample_of_unequal_distances() -> None:
    bench = Bench(4, 8, SYNC_S / 8, lost=(403, 404))
    samples = bench.run(even(200))
    assert all(one == [one[0] - 2 * step for step in range(4)] for one in numbers(samples))
    assert bench.told
    assert all("scans are missing" in text for text in bench.told)
    assert {n for n, one in enumerate(samples) if one is None and n > 10} <= {50, 51, 52}


@pytest.mark.parametrize(("real", "words"), [(8.4, "8.38"), (16, "16"), (4, "4"), (7.5, "7.5"), (3, "3")])
def test_a_number_of_scans_that_does_not_fit_is_told(real: float, words: str) -> None:
    bench = Bench(2, 8, SYNC_S / real)
    bench.run(even(500, jitter_s=0.1 * SYNC_S))
    assert bench.told[-1].startswith(f"scans_per_sync is 8, but {words}")


@pytest.mark.parametrize("scans", [2, 4, 8, 64, 256])
def test_the_right_number_is_not_doubted(scans: int) -> None:
    bench = Bench(1, scans, SYNC_S / scans * (1.0 + 100e-6))
    samples = bench.run(even(1500, jitter_s=0.2 * SYNC_S))
    assert samples.count(None) < 20
    assert not bench.told


def test_a_converter_that_starts_again_begins_a_new_grid() -> None:
    bench = Bench(2, 8, SYNC_S / 8)
    bench.run(even(50))
    bench.picked.forget()
    assert bench.sync(51 * SYNC_S) is None
    samples = bench.run([n * SYNC_S for n in range(52, 60)])
    assert samples[-1] is not None


def test_the_newest_scan_is_taken_once() -> None:
    picked = NewestScan()
    assert picked.take() is None
    picked.came(Sample(1, 2))
    picked.came(Sample(3, 4))
    assert picked.take() == Sample(3, 4)
    assert picked.take() is None
    picked.came(Sample(5, 6))
    picked.forget()
    assert picked.take() is None
