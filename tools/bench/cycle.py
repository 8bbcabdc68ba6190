"""Measure what one cycle and what whole arrays cost, each against something everybody knows.

    python -m tools.bench.cycle [--json] [--check] [--only TEXT] [--repeat N]

Each pair is measured in turns, A B A B, in one run: other work on the machine then meets both alike. Times
are those of the process, not of the clock on the wall. Printed are the medians, the quartiles, and those of
the ratios of neighbours. --check: exit status 1 when a goal is missed. docs/benchmarks.md says more.
"""

from __future__ import annotations

import argparse
import gc
import json
import math
import platform
import statistics
import struct
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, cast

import can
import canopen
import numpy as np

import canfb
from canfb.eds_files import eds_path
from tools.site.markdown import table

NODE_ID, ENCODER_INTERFACE = 32, 16
SYNC, ADC_PDO, POSITION_PDO = 0x080, 0x180 + ENCODER_INTERFACE, 0x180 + NODE_ID
AMPLITUDE_COUNTS = 1500
UNITS_PER_CYCLE = 8192  # of 6004h
STREAM_BLOCK = 65536
TABLE_ENTRIES = 256
INTERVAL_S = 0.001
CYCLES = 500  # frames to frames, in one repetition
SAMPLES = 1_000_000  # of an array
# float64, int16, supervised: numpy's arctangent is ten times as fast with AVX-512, and nothing of ours.
GOALS_AVX512 = 0.45, 0.5, 0.7
GOALS_OTHER = 0.33, 0.4, 0.5
PAIR = struct.Struct("<hh")
COUNTS = struct.Struct("<Ii")


@dataclass(frozen=True)
class Spread:
    """Median and quartiles."""

    median: float
    lower: float
    upper: float

    @classmethod
    def of(cls, values: list[float]) -> Spread:
        lower, median, upper = statistics.quantiles(values, n=4, method="inclusive")
        return cls(median, lower, upper)


@dataclass(frozen=True)
class Result:
    """One comparison; `goal` is what the ratio must stay below, None for information only."""

    name: str
    ours: str
    other: str
    unit: str
    ours_time: Spread
    other_time: Spread
    ratio: Spread
    goal: float | None

    @property
    def is_missed(self) -> bool:
        return self.goal is not None and self.ratio.median >= self.goal


@dataclass(frozen=True)
class Comparison:
    """Two functions that do the same work, `units` times `per` seconds each."""

    name: str
    ours: tuple[str, Callable[[], object]]
    other: tuple[str, Callable[[], object]]
    unit: str
    scale: float  # from seconds of one call to the unit
    goal: float | None = None

    def run(self, repeat: int) -> Result:
        ours: list[float] = []
        other: list[float] = []
        for function in (self.ours[1], self.other[1]):  # warm up
            function()
        for _ in range(repeat):
            ours.append(seconds(self.ours[1]) * self.scale)
            other.append(seconds(self.other[1]) * self.scale)
        ratios = [one / two for one, two in zip(ours, other, strict=True)]
        return Result(
            self.name,
            self.ours[0],
            self.other[0],
            self.unit,
            Spread.of(ours),
            Spread.of(other),
            Spread.of(ratios),
            self.goal,
        )


def seconds(function: Callable[[], object]) -> float:
    started = time.process_time()
    function()
    return time.process_time() - started


# One cycle, frame to frame


class StockNetwork(canopen.Network):
    """A network whose frames end here, as canopen provides for a bus of one's own."""

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        self.last = (can_id, bytes(data))


class NullBus:
    """A python-can bus that keeps the last message: canopen then makes a can.Message of each frame."""

    last: object = None

    def send(self, message: object) -> None:
        self.last = message


def stock_node(network: canopen.Network) -> None:
    """A canopen.LocalNode that answers each ADC PDO with the angle in the cycle, and no more."""
    node = canopen.LocalNode(NODE_ID, str(eds_path("canfb-module")))
    network.add_node(node)
    received, sent = node.rpdo[1], node.tpdo[1]
    received.read(from_od=True)
    sent.cob_id = POSITION_PDO
    sent.clear()
    sent.add_variable(0x6004)
    sine, cosine, position = received.map[0], received.map[1], sent.map[0]
    units_per_radian = UNITS_PER_CYCLE / (2.0 * math.pi)

    def answer(message: object) -> None:
        position.raw = int(math.atan2(sine.raw, cosine.raw) * units_per_radian) & 0xFFFFFFFF
        sent.transmit()

    received.add_callback(answer)


def encoder_table(entries: int = TABLE_ENTRIES, error_cycles: float = 0.01) -> canfb.CorrectionTable:
    """Corrects what Table 1 of the paper leaves, and an encoder with this error."""
    phase = np.arange(4096) / 4096
    raw = canfb.phase_in_cycle(np.sin(2 * np.pi * phase), np.cos(2 * np.pi * phase))
    ideal = np.interp(np.arange(entries) / entries, raw, phase)
    return canfb.CorrectionTable(ideal + error_cycles * np.sin(2 * np.pi * (ideal + 0.1)))


def feedback_module(order: int = 2, times: bool = False, **fields: Any) -> canfb.FeedbackModule:
    """The module with factory defaults, operational, with an active correction table."""
    module = canfb.FeedbackModule(
        canfb.ModuleConfig(
            node_id=NODE_ID,
            encoder_interface=ENCODER_INTERFACE,
            autostart=True,
            prediction_order=order,
            times=times,
            **fields,
        )
    )
    module.start(0.0)
    table = encoder_table()
    module.dictionary.entry(0x2020, 1).download(table.to_bytes())
    module.dictionary.entry(0x2020, 3).download(table.crc32.to_bytes(4, "little"))
    return module


def adc_data(cycles: int, speed: float = 0.3) -> list[bytes]:
    """ADC PDOs of a drive that turns at this speed, cycles per sample."""
    angles = [2 * math.pi * speed * k for k in range(cycles)]
    return [
        PAIR.pack(round(AMPLITUDE_COUNTS * math.sin(x)), round(AMPLITUDE_COUNTS * math.cos(x)))
        for x in angles
    ]


ANALOG_PATHS: dict[str, dict[str, Any]] = {
    "2002:06": {"conditioning": canfb.Conditioning(cosine_delay_s=1e-6)},
    "2002:07": {"conditioning": canfb.Conditioning(delay_s=1e-6)},
    "both, and 2001:05": {
        "conditioning": canfb.Conditioning(cosine_delay_s=1e-6, delay_s=1e-6),
        "corner_hz": 125e3,
    },
}


class ModuleRun:
    """The module, cycle by cycle; what it sends is checked at the end."""

    interval_s = INTERVAL_S

    def __init__(
        self, cycles: int, order: int = 2, *, speed: float = 0.3, times: bool = False, **fields: Any
    ) -> None:
        self.module = feedback_module(order, times, **fields)
        self.sync = canfb.Frame(SYNC, b"")
        self.samples = [canfb.Frame(ADC_PDO, data) for data in adc_data(cycles, speed)]
        self.now = 0.0

    def __call__(self) -> None:
        receive, sync, now = self.module.receive, self.sync, self.now
        sent: list[canfb.Frame] = []
        interval_s = self.interval_s
        for sample in self.samples:
            now += interval_s
            receive(sync, now)
            sent = receive(sample, now)
        self.now = now
        feedback = self.module.feedback
        assert feedback is not None
        assert feedback.status == canfb.StatusBit.VALID | canfb.StatusBit.TABLE_ACTIVE
        assert [one.can_id for one in sent] == [POSITION_PDO]


class TimedRun(ModuleRun):
    """The same with sample times (2000:05), which wrap with each repetition: 512 intervals are 2^32 ticks."""

    CYCLES = 512
    TICKS = 2**32 // CYCLES
    interval_s = TICKS * 1e-7

    def __init__(self) -> None:
        super().__init__(self.CYCLES, speed=160 / self.CYCLES, times=True)
        self.samples = [
            frame._replace(data=frame.data + (number * self.TICKS).to_bytes(4, "little"))
            for number, frame in enumerate(self.samples)
        ]


class StockRun:
    """The same frames into a network with a stock node."""

    def __init__(self, network: canopen.Network, cycles: int) -> None:
        stock_node(network)
        self.network = network
        self.sync = bytearray()
        self.samples = [bytearray(data) for data in adc_data(cycles)]
        self.now = 0.0

    def __call__(self) -> None:
        notify, sync, now = self.network.notify, self.sync, self.now
        for sample in self.samples:
            now += INTERVAL_S
            notify(SYNC, sync, now)
            notify(ADC_PDO, sample, now)
        self.now = now


# Arrays


def tracks(samples: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Position in cycles, sine, cosine: to and fro at up to 0.45 cycles a sample.

    numpy.unwrap needs less than half a cycle a sample; the module does not.
    """
    speed = 0.45 * np.sin(np.arange(samples) * 1e-3)
    position = np.cumsum(speed) + 0.1
    noise = np.random.default_rng(1).normal(0.0, 1.0, (2, samples))
    angle = 2 * np.pi * position
    sine, cosine = AMPLITUDE_COUNTS * np.sin(angle) + noise[0], AMPLITUDE_COUNTS * np.cos(angle) + noise[1]
    return position, sine, cosine


def array_goals() -> tuple[float, float, float]:
    """Of float64, int16 and the supervised stream."""
    found = np.show_config(mode="dicts")["SIMD Extensions"].get("found", [])
    return GOALS_AVX512 if any("AVX512" in name or name == "X86_V4" for name in found) else GOALS_OTHER


def array_comparisons(samples: int) -> list[Comparison]:
    position, sine, cosine = tracks(samples)
    table = encoder_table()
    comparisons = []
    *goals, stream_goal = array_goals()
    for name, kind, goal in zip(("float64", "int16"), (np.float64, np.int16), goals, strict=True):
        s, c = (np.rint(track).astype(kind) if kind is np.int16 else track for track in (sine, cosine))

        def ours(s: np.ndarray = s, c: np.ndarray = c) -> canfb.TrackResult:
            return canfb.process(s, c, table)

        def other(s: np.ndarray = s, c: np.ndarray = c) -> np.ndarray:
            return np.unwrap(np.arctan2(s, c))

        result = ours()
        moved = (result.cycles + result.phase) - (result.cycles[0] + result.phase[0])
        assert result.ok.all()
        assert np.abs(moved - (position - position[0])).max() < 0.1
        assert np.abs(other() - other()[0] - 2 * np.pi * (position - position[0])).max() < 0.1
        comparisons.append(
            Comparison(
                f"{samples} samples, {name}",
                (f"canfb.process, table of {TABLE_ENTRIES}", ours),
                ("numpy.unwrap(numpy.arctan2(s, c))", other),
                "ns per sample",
                1e9 / samples,
                goal,
            )
        )
    comparisons.append(stream_comparison(sine, cosine, table, stream_goal))
    return comparisons


def stream_comparison(
    sine: np.ndarray, cosine: np.ndarray, table: canfb.CorrectionTable, goal: float
) -> Comparison:
    """The supervised chain over the same samples, from one to the next block of them."""
    samples = len(sine)
    parts = [slice(start, start + STREAM_BLOCK) for start in range(0, samples, STREAM_BLOCK)]

    def ours() -> None:
        for result in canfb.process_stream(((sine[part], cosine[part]) for part in parts), table=table):
            assert result.status[-1] == canfb.StatusBit.VALID | canfb.StatusBit.TABLE_ACTIVE

    def other() -> np.ndarray:
        return np.unwrap(np.arctan2(sine, cosine))

    return Comparison(
        f"{samples} samples, supervised",
        (f"canfb.process_stream, table of {TABLE_ENTRIES}, blocks of {STREAM_BLOCK}", ours),
        ("numpy.unwrap(numpy.arctan2(s, c))", other),
        "ns per sample",
        1e9 / samples,
        goal,
    )


# One sample


def bare_arithmetic(data: list[bytes]) -> Callable[[], None]:
    """The least that plain Python needs: unpack, Table 1, eq. 9, residual, pack. No check, no object."""

    def run() -> None:
        cycles = step = 0
        p1 = p2 = 0.0
        for pair in data:
            s, c = PAIR.unpack(pair)
            if abs(s) > abs(c):
                p = (0.25 if s > 0 else 0.75) - 0.125 * (c / s)
            elif c > 0:
                p = 0.125 * (s / c) % 1.0
            else:
                p = 0.5 + 0.125 * (s / c)
            x = 2.0 * p1 - p2 - p
            turns = round(x)
            residual = abs(turns - x)
            step += turns
            cycles += step
            p2, p1 = p1, p
            COUNTS.pack(int(p * 4294967296), cycles)
            if residual > 1.0:
                raise ValueError(residual)

    return run


def sample_comparisons(cycles: int) -> list[Comparison]:
    data = adc_data(cycles)
    bare = bare_arithmetic(data)
    samples = [canfb.Sample(*PAIR.unpack(pair)) for pair in data]
    phases = [canfb.phase_in_cycle(sample.sine, sample.cosine) for sample in samples]
    tracker = canfb.Tracker()
    chain = canfb.SignalChain(canfb.ChainConfig(), encoder_table())

    def track() -> None:
        update = tracker.update
        for phase in phases:
            update(phase)

    def step() -> None:
        take = chain.step
        for sample in samples:
            take(sample)
        assert take(samples[0]).valid

    other = ("bare arithmetic in plain Python", bare)
    unit, scale = "us per sample", 1e6 / cycles
    return [
        Comparison("tracker", ("Tracker.update", track), other, unit, scale),
        Comparison("chain", ("SignalChain.step, with table", step), other, unit, scale),
    ]


def comparisons(cycles: int, samples: int) -> list[Comparison]:
    module = ("canfb.FeedbackModule: ADC PDO, SYNC in, position out", ModuleRun(cycles))
    third = ("the same, with third-order prediction", ModuleRun(cycles, 3))
    second = ("canfb.FeedbackModule with factory defaults", ModuleRun(cycles))
    delayed, lagging, attenuated = (
        (f"the same, with {what}", ModuleRun(cycles, **fields)) for what, fields in ANALOG_PATHS.items()
    )
    adapting = ("the same, with 2002:08", ModuleRun(cycles, adapt=True))
    still = ("the same, the machine stands", ModuleRun(cycles, speed=0.0))
    timed = ("the same, with sample times", TimedRun())
    null_bus = cast(can.BusABC, NullBus())
    frames, messages = StockRun(StockNetwork(), cycles), StockRun(canopen.Network(null_bus), cycles)
    unit, scale = "us per cycle", 1e6 / cycles
    return [
        Comparison("cycle", module, ("canopen.LocalNode with atan2", frames), unit, scale, goal=0.6),
        Comparison("cycle, third order", third, second, unit, scale, goal=1.05),
        Comparison("cycle, cosine delay", delayed, second, unit, scale, goal=1.1),
        Comparison("cycle, delay", lagging, second, unit, scale, goal=1.1),
        Comparison("cycle, adapt", adapting, second, unit, scale, goal=1.1),
        Comparison("cycle, both and corner", attenuated, second, unit, scale),
        Comparison("cycle, at standstill", still, ("canopen.LocalNode with atan2", frames), unit, scale),
        Comparison(
            "cycle, sample times",
            timed,
            ("canopen.LocalNode with atan2", StockRun(StockNetwork(), TimedRun.CYCLES)),
            unit,
            1e6 / TimedRun.CYCLES,
        ),
        Comparison("cycle, can.Message", module, ("the same, with a can.Message", messages), unit, scale),
        *array_comparisons(samples),
        *sample_comparisons(cycles),
    ]


def machine() -> dict[str, str]:
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return {
        "processor": f"{names[0]}, {len(names)} cores" if names else platform.processor() or "unknown",
        "system": platform.system(),
        "python": platform.python_version(),
        **{name: version(name) for name in ("numpy", "canopen", "python-can", "canfb")},
    }


def as_text(results: list[Result], repeat: int) -> str:
    """As in docs/benchmarks.md."""
    rows = [
        (
            one.name,
            in_words(one.ratio),
            verdict(one),
            in_words(one.ours_time),
            in_words(one.other_time),
            one.unit,
        )
        for one in results
    ]
    return "\n".join(
        [
            ", ".join(f"{name} {value}" for name, value in machine().items()) + ".",
            f"Median [quartiles] of {repeat} repetitions, processor time.\n",
            *table(("name", "ratio", "goal", "ours", "the other", "unit"), rows),
        ]
    )


def verdict(result: Result) -> str:
    if result.goal is None:
        return ""
    return f"< {result.goal:g}: {'MISSED' if result.is_missed else 'met'}"


def in_words(spread: Spread) -> str:
    return f"{spread.median:.2f} [{spread.lower:.2f} .. {spread.upper:.2f}]"


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tools.bench.cycle", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument("--check", action="store_true", help="exit status 1 when a goal is missed")
    parser.add_argument("--only", default="", metavar="TEXT", help="only what has this text in its name")
    parser.add_argument(
        "--repeat", type=int, default=101, help="repetitions, at least 2 (default %(default)s)"
    )
    parser.add_argument("--cycles", type=int, default=CYCLES, help="cycles of one repetition")
    parser.add_argument("--samples", type=int, default=SAMPLES, help="samples of an array")
    options = parser.parse_args(arguments)
    if options.repeat < 2 or options.cycles < 100 or options.samples < 100:
        parser.error("--repeat must be at least 2, --cycles and --samples at least 100")
    work = [one for one in comparisons(options.cycles, options.samples) if options.only in one.name]
    if not work:
        parser.error(f"nothing has {options.only!r} in its name")
    gc.collect()
    results = [comparison.run(options.repeat) for comparison in work]
    if options.json:
        print(json.dumps({"machine": machine(), "results": [asdict(result) for result in results]}, indent=2))
    else:
        print(as_text(results, options.repeat))
    return 1 if options.check and any(result.is_missed for result in results) else 0


if __name__ == "__main__":
    sys.exit(main())
