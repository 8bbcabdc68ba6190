"""How long the module itself takes for a frame, in the process of tools.bench.latency and without a bus."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

try:
    from canfb.cia301.frame import Frame, frame_bits
    from tools.bench.cycle import ADC_PDO, INTERVAL_S, SYNC, adc_data, feedback_module
    from tools.bench.latency_load import Load
except ImportError as error:
    sys.exit(f"{error}: run this file with the Python of the virtual environment")

WARM_UP = 300
SAMPLES = 1000  # that repeat
BIT_S = 1e-6
LOAD_S = frame_bits(8) * BIT_S
ADC_S = frame_bits(0) * BIT_S + frame_bits(4) * BIT_S
CALLS = "SYNC", "ADC PDO", "load frame", "tick"


@dataclass
class CallTimes:
    """Of one kind of call, in µs: on the wall, and of the processor for this thread."""

    wall_us: list[float] = field(default_factory=list)
    processor_us: list[float] = field(default_factory=list)


class Calls:
    """Gives a module the frames of SYNC periods of 1 ms, in simulated time, and measures each call."""

    def __init__(self, load: Load) -> None:
        self._module = feedback_module()
        self._load = load
        self._samples = [Frame(ADC_PDO, data) for data in adc_data(SAMPLES)]
        self._cycle = 0
        self.times = {kind: CallTimes() for kind in CALLS}
        self.play(WARM_UP)
        for kind in CALLS:
            self.times[kind] = CallTimes()

    def play(self, cycles: int) -> None:
        """So many periods; a position PDO must follow each ADC PDO."""
        module, load, times, sync = self._module, self._load, self.times, Frame(SYNC, b"")
        receive = module.receive
        for _ in range(cycles):
            self._cycle += 1
            began_s = self._cycle * INTERVAL_S
            self._call(times["SYNC"], partial(receive, sync, began_s))
            sample = self._samples[self._cycle % SAMPLES]
            if not self._call(times["ADC PDO"], partial(receive, sample, began_s + ADC_S)):
                raise RuntimeError("no position PDO")
            now = began_s + ADC_S + LOAD_S
            while now < began_s + INTERVAL_S - LOAD_S:
                deadline = module.deadline()
                if deadline is not None and deadline <= now:
                    self._call(times["tick"], partial(module.tick, now))
                if load.waits:
                    frame = Frame(*load.frame)
                    load.sent()
                    self._call(times["load frame"], partial(receive, frame, now))
                now += LOAD_S

    def _call(self, times: CallTimes, call: Callable[[], list[Frame]]) -> list[Frame]:
        wall, processor = time.perf_counter_ns(), time.thread_time_ns()
        answers = call()
        processor_ns, wall_ns = time.thread_time_ns() - processor, time.perf_counter_ns() - wall
        times.wall_us.append(wall_ns * 1e-3)
        times.processor_us.append(processor_ns * 1e-3)
        for answer in answers:
            self._load.take(answer.can_id, answer.data)
        return answers
