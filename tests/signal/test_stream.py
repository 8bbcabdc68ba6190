"""Streams and arrays against single samples, bit for bit, with blocks so short that every seam is met."""

import math
import tracemalloc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import pairwise
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import example, given, strategies as st

from canfb import ChainConfig, Conditioning, CorrectionTable, Sample, SignalChain, StatusBit, phase_in_cycle
from canfb.signal import blocks, stream
from canfb.signal.blocks import BLOCK_SAMPLES
from canfb.signal.estimator import Estimator
from canfb.signal.limits import Declared
from canfb.signal.stages import Stages
from canfb.signal.stream import ChainResult, process, process_stream
from canfb.signal.tracker import Tracker, TrackResult, track
from drawing import examples
from folding import each

Array = np.ndarray
FIELDS = ("cycles", "phase", "residual", "amplitude", "raw_phase", "status")
AMPLITUDE = 1500.0
FULL_SCALE = 2048
X = np.arange(64) / 64
TABLE = CorrectionTable(X + 0.02 * np.sin(2 * np.pi * X) - 0.01)
CONDITIONING = Conditioning(12.5, -7.0, 1.1, 0.9, 0.1)
DELAYED = Conditioning(12.5, -7.0, 1.1, 0.9, 0.1, 1e-4, 1e-3, harmonic_3_forward_real=0.02)


def one_by_one(
    sine: Array, cosine: Array, config: ChainConfig, table: CorrectionTable | None = None, speed: float = 0.0
) -> ChainResult:
    chain = SignalChain(config, table)
    chain.restart(0, speed)
    result = ChainResult.empty(len(sine))
    for k, pair in enumerate(zip(sine.tolist(), cosine.tolist(), strict=True)):
        got = chain.step(Sample(*pair))
        for name in FIELDS:
            getattr(result, name)[k] = getattr(got, name)
    return result


def in_blocks(
    sine: Array,
    cosine: Array,
    config: ChainConfig,
    table: CorrectionTable | None = None,
    lengths: list[int] | None = None,
    speed: float = 0.0,
) -> ChainResult:
    """The lengths are used again and again until the samples end."""
    lengths = lengths or [len(sine)]
    edges = [0]
    while edges[-1] < len(sine):
        edges.append(edges[-1] + lengths[(len(edges) - 1) % len(lengths)])
    blocks = [(sine[a:b], cosine[a:b]) for a, b in pairwise(edges)]
    results = list(process_stream(blocks, config, table, speed))
    assert [len(result.phase) for result in results] == [len(block[0]) for block in blocks]
    return ChainResult(*(np.concatenate([getattr(one, name) for one in results]) for name in FIELDS))


def tracks_at(position: Array) -> tuple[Array, Array]:
    angle = 2 * np.pi * position
    return AMPLITUDE * np.sin(angle), AMPLITUDE * np.cos(angle)


Motion = Callable[[int, np.random.Generator], Array]
MOTIONS: dict[str, Motion] = {
    "standstill": lambda n, rng: np.full(n, rng.random()),
    "constant": lambda n, rng: np.arange(n) * rng.uniform(-0.45, 0.45),
    # Up to some whole cycles per sample: the same phase each time.
    "whole": lambda n, rng: np.cumsum(np.minimum(np.arange(n) // 5 * 0.25, rng.integers(0, 4))) + 0.1,
    "wandering": lambda n, rng: np.cumsum(np.cumsum(rng.uniform(-0.1, 0.1, n))),
    "stop and go": lambda n, rng: np.cumsum(0.2 * (np.sin(np.arange(n) * 0.1) > 0)),
}
ENDS = [FULL_SCALE - 1, -FULL_SCALE, FULL_SCALE - 2, FULL_SCALE - 3]
# What becomes of a row of samples.
FAULTS: list[Callable[[Array, Array, np.random.Generator], tuple[Array, Array]]] = [
    lambda s, c, rng: (np.zeros_like(s), c),
    lambda s, c, rng: (np.zeros_like(s), np.zeros_like(c)),
    lambda s, c, rng: (np.full_like(s, rng.choice(ENDS)), c),
    lambda s, c, rng: (np.full_like(s, s[0]), np.full_like(c, c[0])),  # frozen
    lambda s, c, rng: (c, s),
    lambda s, c, rng: (s, -c),
    lambda s, c, rng: (s * 0.27, c * 0.27),
    lambda s, c, rng: (s * rng.choice([0.1, 0.28, 2.0]), c * rng.choice([0.1, 0.28, 2.0])),
    lambda s, c, rng: (s + rng.normal(0.0, 400.0, len(s)), c),
    lambda s, c, rng: (np.full_like(s, rng.choice([math.nan, math.inf, -1e300])), c),
]


def recording(seed: int, samples: int, motion: str, rate: float, noise: float) -> Array:
    """A motion with faults of any kind and length at this part of the samples."""
    rng = np.random.default_rng(seed)
    both = np.array(tracks_at(MOTIONS[motion](samples, rng)))
    both += noise * rng.normal(size=both.shape)
    if rng.random() < 0.7:
        both = np.rint(both)
    for at in np.flatnonzero(rng.random(samples) < rate):
        part = slice(at, at + int(rng.choice([1, 1, 2, 3, 5, 30])))
        sine, cosine = both[:, part].copy()
        both[:, part] = FAULTS[rng.integers(len(FAULTS))](sine, cosine, rng)
    return both


@examples(150)
@given(
    seed=st.integers(0, 2**32),
    samples=st.integers(1, 700),
    motion=st.sampled_from(sorted(MOTIONS)),
    rate=st.sampled_from([0.0, 0.002, 0.01, 0.05, 0.3]),
    noise=st.sampled_from([0.0, 1.0, 20.0]),
    lengths=st.lists(st.sampled_from([0, 1, 2, 3, 7, 15, 16, 17, 40, 300, 1000]), min_size=1).filter(any),
    table=st.sampled_from([None, TABLE]),
    config=st.builds(
        ChainConfig,
        conditioning=st.sampled_from([Conditioning(), CONDITIONING, DELAYED]),
        corner_hz=st.sampled_from([0.0, 0.0, 300.0]),
        interval_s=st.just(1e-3),
        residual_limit=st.sampled_from([0.1, 1 / 3, 0.5]),
        coast_samples=st.sampled_from([0, 1, 3, 40]),
        frozen_samples=st.sampled_from([0, 1, 2, 3, 16]),
        amplitude_low_counts=st.sampled_from([None, 0]),
        max_acceleration_cycles=st.sampled_from([0.0, 0.01, 0.1]),
    ),
    kind=st.sampled_from([np.float64, np.int16, np.float32]),
    part=st.sampled_from([17, 40, 300, BLOCK_SAMPLES]),
    speed=st.sampled_from([0.0, 0.0, 0.3, -0.7, 83.4, 1e6]),
)
def test_a_stream_gives_the_bits_of_single_samples(
    seed: int,
    samples: int,
    motion: str,
    rate: float,
    noise: float,
    lengths: list[int],
    table: CorrectionTable | None,
    config: ChainConfig,
    kind: type[np.generic],
    part: int,
    speed: float,
) -> None:
    """From standstill, and from a speed that is said to be that of the first sample, whatever it is."""
    sine, cosine = recording(seed, samples, motion, rate, noise)
    if kind is np.int16:
        sine, cosine = (np.clip(np.nan_to_num(track), -32768, 32767) for track in (sine, cosine))
    with np.errstate(over="ignore"):
        sine, cosine = sine.astype(kind), cosine.astype(kind)
    wanted = one_by_one(sine, cosine, config, table, speed)
    with patch.object(stream, "BLOCK_SAMPLES", part):
        got = in_blocks(sine, cosine, config, table, lengths, speed)
    for name in FIELDS:
        ours, theirs = getattr(got, name), getattr(wanted, name)
        assert ours.dtype == theirs.dtype
        differ = np.flatnonzero((ours != theirs) & ~((ours != ours) & (theirs != theirs)))
        assert not len(differ), f"{name} at {differ[0]}: {ours[differ[0]]!r}, not {theirs[differ[0]]!r}"


def test_the_samples_of_a_block_are_left_as_they_are_and_may_be_overwritten() -> None:
    sine, cosine = tracks_at(np.arange(3000) * 0.1)
    buffers = np.empty(1000), np.empty(1000)

    def reader() -> Iterator[tuple[Array, Array]]:
        for start in range(0, 3000, 1000):
            buffers[0][:], buffers[1][:] = sine[start : start + 1000], cosine[start : start + 1000]
            yield buffers
            assert (buffers[0] == sine[start : start + 1000]).all()

    results = list(process_stream(reader()))
    position = np.concatenate([one.cycles + one.phase for one in results])
    assert np.abs(position - np.arange(3000) * 0.1).max() < 0.02


def test_no_block_and_empty_blocks() -> None:
    assert list(process_stream([])) == []
    (got,) = process_stream([([], [])])
    assert [len(getattr(got, name)) for name in FIELDS] == [0] * 6
    assert got.status.dtype == np.uint16


def test_memory_is_that_of_one_block() -> None:
    """However long the stream is; 25 million samples would be a gigabyte of results."""
    length = 1 << 16
    block = tracks_at(np.arange(length) * 0.25)

    def peak(blocks: int) -> int:
        tracemalloc.start()
        try:
            for result in process_stream((block for _ in range(blocks)), speed_cycles=0.0):
                assert result.valid.all()
            return tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()

    peak(1)  # what is made once
    few, many = peak(4), peak(150)  # 10^7 samples
    assert many < few + 100_000
    assert many < 3 * length * 6 * 8


def test_faults_at_every_few_samples_cost_no_more_than_single_samples(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """What is computed in vain stays a small multiple of the samples: it does not grow with the block."""
    computed = 0
    follow_run = Stages.follow_run

    def counting(stages: Stages, *arguments: object) -> int:
        nonlocal computed
        run = arguments[2]
        assert isinstance(run, TrackResult)
        computed += len(run.phase)
        return follow_run(stages, *arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(Stages, "follow_run", counting)
    n = 2 * BLOCK_SAMPLES
    for apart in (5, 20, 40, 200):
        computed = 0
        position = np.zeros(n)
        position[::apart] = 0.4  # over the limit of the residual, which only eq. 9 shows
        sine, cosine = tracks_at(position)
        list(process_stream([(sine, cosine)], ChainConfig(coast_samples=255)))
        assert computed <= 4 * n


PLACES = np.arange(64) / 64
TABLES = {
    "none": None,
    "starts above 0": CorrectionTable(PLACES + 0.01 * np.sin(2 * np.pi * (PLACES + 0.1))),
    "starts below 0": CorrectionTable(PLACES + 0.01 * np.sin(2 * np.pi * (PLACES - 0.1))),
    "starts a hair above 0": CorrectionTable(np.where(PLACES == 0.0, 1e-10, PLACES)),
    "starts a hair below 0": CorrectionTable(np.where(PLACES == 0.0, -1e-30, PLACES)),
}
counts = st.integers(-32768, 32767)
odd = st.sampled_from([0.0, -0.0, 1e-300, -1e-300, 5e-324, 1e149, 1e150, -math.inf, math.nan])
values = st.one_of(counts.map(float), st.floats(-2e3, 2e3), odd)


@contextmanager
def blocks_of(samples: int) -> Iterator[None]:
    with patch.object(blocks, "BLOCK_SAMPLES", samples), patch.object(stream, "BLOCK_SAMPLES", samples):
        yield


def bits(result: TrackResult) -> list[bytes]:
    return [array.tobytes() for array in (result.cycles, result.phase, result.residual, result.ok)]


def columns(rows: list[tuple[int, float, float, bool]]) -> list[bytes]:
    kinds = (np.int64, np.float64, np.float64, np.bool_)
    each = zip(*rows, strict=True) if rows else ([], [], [], [])
    return [np.array(list(column), kind).tobytes() for column, kind in zip(each, kinds, strict=True)]


def by_the_estimator(sines: list[float], cosines: list[float], table: CorrectionTable | None) -> list[bytes]:
    """Any floats, also those that no converter gives."""
    recovery, rows = Estimator(Declared()), []
    for sine, cosine in zip(sines, cosines, strict=True):
        is_count = abs(sine) < 1e150 and abs(cosine) < 1e150
        raw = phase_in_cycle(sine, cosine) if is_count else math.nan
        phase = raw if table is None else table(raw)
        track, status = recovery.bad(1.0) if math.isnan(phase) else recovery.good(phase, 1.0)
        rows.append((track.cycles, track.phase, track.residual, bool(status & StatusBit.VALID)))
    return columns(rows)


@pytest.mark.parametrize("table", TABLES.values(), ids=TABLES)
@given(st.lists(st.tuples(values, values), max_size=40), st.integers(1, 9))
@example(
    [(0.0, 0.0)] * 3 + [(1.0, 2.0), (2.0, 1.0), (2.0, -1.0), (1.0, 5.0)], 4
)  # the first phase ends a block
@example([(1.0, 2.0), (0.0, 0.0), (2.0, 1.0), (2.0, -1.0), (1.0, 5.0), (1.0, 9.0)], 3)  # a gap does
@example([(-1e-300, 1.0), (-1e-300, 1e149), (-0.0, 1.0), (5e-324, 3.0)], 2)  # raw phase 1.0 is 0.0
def test_process_gives_the_bits_of_the_scalar_path(
    table: CorrectionTable | None, pairs: list[tuple[float, float]], samples: int
) -> None:
    sines, cosines = [pair[0] for pair in pairs], [pair[1] for pair in pairs]
    with blocks_of(samples):
        assert bits(process(sines, cosines, table, speed_cycles=0.0)) == by_the_estimator(
            sines, cosines, table
        )


@pytest.mark.parametrize("speed", [math.nan, math.inf, 1e10, "83", "", None, 1j, 0j, True, False])
def test_a_speed_that_is_none_is_refused(speed: object) -> None:
    for run in (
        lambda: process([1.0], [1.0], speed_cycles="83" if speed is None else speed),  # type: ignore[arg-type]
        lambda: track([0.5], speed_cycles=speed),  # type: ignore[arg-type]
        lambda: Tracker(speed_cycles=speed),  # type: ignore[arg-type]
        lambda: process_stream([], speed_cycles="83" if speed is None else speed),  # type: ignore[arg-type]
    ):
        with pytest.raises(ValueError, match="speed_cycles"):
            run()


PHASES = st.floats(0, 1, exclude_max=True)


@given(
    st.lists(st.one_of(PHASES, PHASES, st.just(math.nan)), max_size=60),
    st.floats(0.01, 0.5),
    st.integers(1, 9),
    st.sampled_from([0.0, -0.4, 7.5, 2.0**31, -(2.0**31)]),
)
def test_track_gives_the_bits_of_a_tracker(
    phases: list[float], limit: float, samples: int, speed: float
) -> None:
    tracker = Tracker(limit, speed)
    with blocks_of(samples):
        assert bits(track(phases, limit, speed)) == columns([(*tracker.update(phase),) for phase in phases])


@each("table", TABLES.values())
@each("kind", ["int8", "int16", ">i2", "int32", "int64", "float32", "float64", "object"])
def test_any_kind_of_number_gives_the_bits_of_its_float64(kind: str, table: CorrectionTable | None) -> None:
    low, high = (-128, 127) if kind == "int8" else (-32768, 32767)
    numbers = np.random.default_rng(1).integers(low, high, (2, 500), endpoint=True)
    numbers[:, :3] = [[low, low, high], [low, high, low]]
    sines, cosines = numbers.astype(kind)
    want = bits(process(sines.astype(np.float64), cosines.astype(np.float64), table, speed_cycles=0.0))
    assert bits(process(sines, cosines, table, speed_cycles=0.0)) == want
    assert bits(process(sines[::-1], cosines[::-1], table, speed_cycles=0.0)) == bits(
        process(sines[::-1].astype(np.float64), cosines[::-1].astype(np.float64), table, speed_cycles=0.0)
    )


@given(st.floats(0, 1), st.sampled_from([name for name in TABLES if name != "none"]))
@example(1.0, "starts a hair above 0")
def test_raw_phase_1_is_raw_phase_0_for_a_table(raw: float, name: str) -> None:
    table = TABLES[name]
    assert table is not None
    many = table.correct_array(np.array([[raw, 1.0, 0.0]]))
    assert many.shape == (1, 3)
    assert many[0].tolist() == [table(raw), table(0.0), table(0.0)]
    assert table.correct(1.0) == table.correct(0.0)


def test_an_option_that_it_does_not_have_is_named() -> None:
    with pytest.raises(ValueError, match="cosine_delay_s needs interval_s"):
        process_stream([], ChainConfig(conditioning=Conditioning(cosine_delay_s=1e-6)))
    with pytest.raises(TypeError, match="no option 'coast'; it takes max_acceleration_cycles"):
        process([1.0, 2.0], [1.0, 2.0], coast=1)
    with pytest.raises(ValueError, match="phase_error_cycles"):
        process([100.0, 200.0], [100.0, 200.0], phase_error_cycles=0.0)
