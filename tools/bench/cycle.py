"""Measure the time of one cycle and of whole arrays, each relative to a well-known operation, with pyperf.

    python -m tools.bench.cycle [--only TEXT] [--check] [options of pyperf]

pyperf runs each piece of work in separate processes, and prints mean and standard deviation; `-o FILE` stores
all values, and `python -m pyperf compare_to BEFORE AFTER` compares two versions. Times are processor times of
the process. The ratios of the medians come last. --check: exit status 1 when a goal is missed.
"""

import argparse
import math
import struct
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any

import canopen
import numpy as np
import pyperf

import canfb
from canfb.eds_files import eds_path
from canfb.simulation.encoder import Encoder
from tools.faults.machine import exact_table
from tools.site.text import table

NODE_ID, ENCODER_INTERFACE = 32, 16
SYNC, ADC_PDO, POSITION_PDO = 0x080, 0x180 + ENCODER_INTERFACE, 0x180 + NODE_ID
AMPLITUDE_COUNTS = 1500
UNITS_PER_CYCLE = 8192  # default scale of 6004h
STREAM_BLOCK = 65536
TABLE_ENTRIES = 256
INTERVAL_S = 0.001
CYCLES = 500  # cycles, from frames to frames, in one repetition
SAMPLES = 1_000_000  # samples of an array
# Goals for float64, int16, supervised: AVX-512 makes arctan2 of numpy ten times faster, but not canfb.
GOALS_AVX512 = 0.45, 0.5, 0.7
GOALS_OTHER = 0.33, 0.4, 0.5
PAIR = struct.Struct("<hh")
Work = Callable[[], object]


def warm(make: Callable[[], Any]) -> Any:
    work = make()
    for _ in range(4):  # until the warning of a start in motion is over
        work()
    return work


def seconds(make: Callable[[], Work], loops: int) -> float:
    work = warm(make)
    started = time.process_time()
    for _ in range(loops):
        work()
    return time.process_time() - started


def seconds_slept(make: Callable[[], Any], loops: int) -> float:
    """The same with a sleep of one interval before each cycle, after which the caches are cold."""
    run = warm(make)
    spent = 0.0
    for sample in run.samples * loops:
        time.sleep(INTERVAL_S)
        started = time.process_time()
        run.cycles([sample])
        spent += time.process_time() - started
    return spent


@dataclass(frozen=True)
class Timed:
    """Work that is timed: ``make`` prepares and checks it; a call of the result does it ``units`` times."""

    make: Callable[[], Work]
    units: int
    seconds: Callable[[Callable[[], Any], int], float] = seconds


@dataclass(frozen=True)
class Comparison:
    """Names of two pieces of equivalent work; `goal`: limit of the ratio of their times."""

    name: str
    ours: str
    other: str
    goal: float

    def verdict(self, ratio: float) -> str:
        return f"< {self.goal:g}: {'MISSED' if ratio >= self.goal else 'met'}"


# One cycle, frame to frame


class StockNetwork(canopen.Network):
    """A network without a bus, as canopen allows: its frames end here."""

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        self.last = (can_id, bytes(data))


def stock_node(network: canopen.Network) -> None:
    """A canopen.LocalNode that answers each ADC PDO with the angle in the cycle, and does nothing else."""
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
    """A table that corrects the error of Table 1 of the paper, and an encoder with this error."""
    ideal = exact_table(entries=entries).entries
    return canfb.CorrectionTable(ideal + error_cycles * np.sin(2 * np.pi * (ideal + 0.1)))


def feedback_module(**fields: Any) -> canfb.FeedbackModule:
    """A module with these fields, else factory defaults, OPERATIONAL, with an active correction table."""
    words = {"node_id": NODE_ID, "encoder_interface": ENCODER_INTERFACE, "autostart": True}
    module = canfb.FeedbackModule(canfb.ModuleConfig(**words | fields))
    module.start(0.0)
    table = encoder_table()
    module.dictionary.entry(0x2020, 1).download(table.to_bytes())
    module.dictionary.entry(0x2020, 3).download(table.crc32.to_bytes(4, "little"))
    return module


def adc_data(cycles: int, speed: float = 0.3) -> list[bytes]:
    """Data of ADC PDOs of a machine at this speed, cycles per sample."""
    encoder = Encoder(amplitude_counts=AMPLITUDE_COUNTS)
    return [PAIR.pack(*pair) for pair in zip(*encoder.sample(speed * np.arange(cycles)), strict=True)]


class ModuleRun:
    interval_s = INTERVAL_S

    def __init__(self, cycles: int, *, speed: float = 0.3, **fields: Any) -> None:
        self.module = feedback_module(**fields)
        self.sync = canfb.Frame(SYNC, b"")
        self.samples = [canfb.Frame(ADC_PDO, data) for data in adc_data(cycles, speed)]
        self.now = 0.0

    def cycles(self, samples: list[canfb.Frame]) -> None:
        receive, sync, now, interval_s = self.module.receive, self.sync, self.now, self.interval_s
        for sample in samples:
            now += interval_s
            receive(sync, now)
            self.sent = receive(sample, now)
        self.now = now

    def __call__(self) -> None:
        self.cycles(self.samples)
        feedback = self.module.feedback
        assert feedback is not None
        assert feedback.status == canfb.StatusBit.VALID | canfb.StatusBit.TABLE_ACTIVE
        assert [one.can_id for one in self.sent] == [POSITION_PDO]


class TimedRun(ModuleRun):
    """The same with sample times (2000:05), wrong by up to 3 ticks, which wrap after 512 intervals."""

    CYCLES = 512
    TICKS = 2**32 // CYCLES
    interval_s = TICKS * 1e-7

    def __init__(self) -> None:
        super().__init__(self.CYCLES, speed=160 / self.CYCLES, times=True)
        ticks = [(number * self.TICKS + number % 7 - 3) % 2**32 for number in range(self.CYCLES)]
        self.samples = [
            frame._replace(data=frame.data + time.to_bytes(4, "little"))
            for frame, time in zip(self.samples, ticks, strict=True)
        ]


class StockRun:
    def __init__(self) -> None:
        self.network = StockNetwork()
        stock_node(self.network)
        self.sync = bytearray()
        self.samples = [bytearray(data) for data in adc_data(CYCLES)]
        self.now = 0.0

    def cycles(self, samples: list[bytearray]) -> None:
        notify, sync, now = self.network.notify, self.sync, self.now
        for sample in samples:
            now += INTERVAL_S
            notify(SYNC, sync, now)
            notify(ADC_PDO, sample, now)
        self.now = now

    def __call__(self) -> None:
        self.cycles(self.samples)


# Arrays


def tracks(kind: type = np.float64) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Position in cycles, sine, cosine of this type: an oscillation at up to 0.45 cycles per sample.

    numpy.unwrap requires less than 0.5 cycle per sample; the module does not.
    """
    position = np.cumsum(0.45 * np.sin(np.arange(SAMPLES) * 1e-3)) + 0.1
    noise = np.random.default_rng(1).normal(0.0, 1.0, (2, SAMPLES))
    angle = 2 * np.pi * position
    counts = AMPLITUDE_COUNTS * np.stack([np.sin(angle), np.cos(angle)]) + noise
    sine, cosine = np.rint(counts).astype(kind) if kind is np.int16 else counts
    return position - position[0], sine, cosine


def array_goals() -> tuple[float, float, float]:
    found = np.show_config(mode="dicts")["SIMD Extensions"].get("found", [])
    return GOALS_AVX512 if any("AVX512" in name or name == "X86_V4" for name in found) else GOALS_OTHER


def process_arrays(kind: type) -> Work:
    """`canfb.process` of samples of this type; checks that the positions are right."""
    way, sine, cosine = tracks(kind)
    ours = partial(canfb.process, sine, cosine, encoder_table(), speed_cycles=0.0)
    result = ours()
    moved = result.cycles + result.phase
    assert result.ok.all()
    assert np.abs(moved - moved[0] - way).max() < 0.1
    return ours


def unwrap_arrays(kind: type) -> Work:
    way, sine, cosine = tracks(kind)

    def other() -> np.ndarray:
        return np.unwrap(np.arctan2(sine, cosine))

    assert np.abs(other() - other()[0] - 2 * np.pi * way).max() < 0.1
    return other


def supervised_stream() -> Work:
    """The supervised chain over the same samples, block by block."""
    _, sine, cosine = tracks()
    table = encoder_table()
    parts = [slice(start, start + STREAM_BLOCK) for start in range(0, len(sine), STREAM_BLOCK)]

    def ours() -> None:
        for result in canfb.process_stream(((sine[part], cosine[part]) for part in parts), table=table):
            assert result.status[-1] == canfb.StatusBit.VALID | canfb.StatusBit.TABLE_ACTIVE

    return ours


def module_run(**fields: Any) -> Timed:
    return Timed(partial(ModuleRun, CYCLES, **fields), CYCLES)


MODULE, STOCK, NUMPY, NUMPY_16 = "module", "canopen", "numpy, float64", "numpy, int16"
SLEPT = ", after a sleep"
WORK: dict[str, Timed] = {
    MODULE: module_run(),
    "2002:06": module_run(conditioning=canfb.Conditioning(cosine_delay_s=1e-6)),
    "2002:07": module_run(conditioning=canfb.Conditioning(delay_s=1e-6)),
    "2002:08": module_run(adapt=True),
    "sample times": Timed(TimedRun, TimedRun.CYCLES),
    STOCK: Timed(StockRun, CYCLES),
    MODULE + SLEPT: replace(module_run(), seconds=seconds_slept),
    STOCK + SLEPT: Timed(StockRun, CYCLES, seconds_slept),
    "process, float64": Timed(partial(process_arrays, np.float64), SAMPLES),
    "process, int16": Timed(partial(process_arrays, np.int16), SAMPLES),
    "process_stream": Timed(supervised_stream, SAMPLES),
    NUMPY: Timed(partial(unwrap_arrays, np.float64), SAMPLES),
    NUMPY_16: Timed(partial(unwrap_arrays, np.int16), SAMPLES),
}


def comparisons() -> list[Comparison]:
    floats, counts, stream = array_goals()
    return [
        Comparison("cycle", MODULE, STOCK, 0.6),
        Comparison("cycle after 1 ms of sleep", MODULE + SLEPT, STOCK + SLEPT, 0.8),
        Comparison("cycle, cosine delay", "2002:06", MODULE, 1.1),
        Comparison("cycle, delay", "2002:07", MODULE, 1.1),
        Comparison("cycle, adapt", "2002:08", MODULE, 1.1),
        Comparison("cycle, sample times", "sample times", MODULE, 1.1),
        Comparison("samples, float64", "process, float64", NUMPY, floats),
        Comparison("samples, int16", "process, int16", NUMPY_16, counts),
        Comparison("samples, supervised", "process_stream", NUMPY, stream),
    ]


def pass_on(command: list[str], options: argparse.Namespace) -> None:
    """Pass --only to the measuring processes, which identify a piece of work by its number."""
    command += ["--only", options.only]


def main(arguments: list[str] | None = None) -> int:
    runner = pyperf.Runner(
        processes=3, values=5, program_args=("-m", "tools.bench.cycle"), add_cmdline_args=pass_on
    )
    runner.argparser.add_argument("--check", action="store_true", help="exit status 1 when a goal is missed")
    runner.argparser.add_argument("--only", default="", metavar="TEXT", help="what has this text in its name")
    options = runner.parse_args(arguments)
    options.inherit_environ = [*(options.inherit_environ or []), "OPENBLAS_NUM_THREADS"]
    chosen = [one for one in comparisons() if options.only in one.name]
    if not chosen:
        runner.argparser.error(f"nothing has {options.only!r} in its name")
    medians: dict[str, float] = {}
    for name, timed in WORK.items():
        if any(name in (one.ours, one.other) for one in chosen):
            work = partial(timed.seconds, cache(timed.make))
            measured = runner.bench_time_func(name, work, inner_loops=timed.units)
            if not options.worker:  # a worker measures only one piece
                medians[name] = measured.median()
    return 0 if options.worker else report(chosen, medians, check=options.check)


def report(chosen: list[Comparison], medians: dict[str, float], *, check: bool) -> int:
    """Print the ratios of the medians; 1 if a goal is missed and ``check``."""
    ratios = {one: medians[one.ours] / medians[one.other] for one in chosen}
    rows = [
        (one.name, f"{ratio:.2f}", one.verdict(ratio), one.ours, one.other) for one, ratio in ratios.items()
    ]
    print("\n".join(["", *table(("name", "ratio", "goal", "ours", "the other"), rows)]))
    missed = any(ratio >= one.goal for one, ratio in ratios.items())
    return 1 if check and missed else 0


if __name__ == "__main__":
    sys.exit(main())
