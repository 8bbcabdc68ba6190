"""Measure how long `canfb replay` takes for a log, compared with python-can reading it.

    python -m tools.bench.replay [--cycles N] [--repeat N] [--json]

The logs are made here: SYNC, ADC PDO, position PDO (TPDO1, TPDO2) of one module; the same with as many
frames of other nodes; and SYNC and ADC PDO alone, where nearly each frame is work for the module. Both times
are of this process, one after the other in each repetition; printed are the median of their ratios, and the
least and the largest.
"""

from __future__ import annotations

import argparse
import json
import math
import statistics
import struct
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

try:
    import can

    from canfb.cia301.frame import Frame
    from canfb.logs.log_replay import ReplaySettings, replay_log
    from canfb.module.feedback_module import FeedbackModule
    from canfb.module.module_config import ModuleConfig
except ImportError as error:
    sys.exit(f"{error}: run this file with the Python of the virtual environment")

CONFIG = ModuleConfig(node_id=0x20, encoder_interface=0x10, autostart=True)
EPOCH_S, PERIOD_S = 1_700_000_000.0, 1e-3
SYNC, ADC, OTHER = 0x080, 0x190, 0x201
SUFFIXES = (".log", ".blf", ".asc")
KINDS = ("module", "module and others", "samples alone")
ALLOWED_RATIO = 1.3


def frames(kind: str, cycles: int) -> list[Frame]:
    """A log of this kind, with stamps."""
    module = FeedbackModule(CONFIG)
    module.start(0.0)
    log: list[Frame] = []
    for n in range(cycles):
        angle = 0.02 * math.pi * n
        counts = struct.pack("<hh", round(1500 * math.sin(angle)), round(1500 * math.cos(angle)))
        for frame in (
            Frame(SYNC, b"", False, n * PERIOD_S),
            Frame(ADC, counts, False, n * PERIOD_S + 2e-4),
        ):
            at = frame.timestamp or 0.0
            answers = module.receive(frame, at)
            log.append(frame)
            if kind != KINDS[2]:
                log += [answer._replace(timestamp=at + 5e-5) for answer in answers]
            if kind == KINDS[1]:
                log += [Frame(OTHER + k, bytes(8), False, at + 6e-5) for k in range(2)]
    return log


def write(path: Path, log: Sequence[Frame]) -> None:
    with can.Logger(path) as logger:
        for can_id, data, _, stamp in log:
            time_s = EPOCH_S + (stamp or 0.0)
            logger(can.Message(time_s, can_id, is_extended_id=False, data=data, channel=0))


def seconds(work: Callable[[], object]) -> float:
    begin = time.process_time()
    work()
    return time.process_time() - begin


def compare(path: Path, repeat: int) -> dict[str, float]:
    """Microseconds for a frame, and the ratios of the pairs."""
    count = sum(1 for _ in can.LogReader(path))
    reading, replaying = [], []
    for _ in range(repeat):
        reading.append(seconds(lambda: sum(1 for _ in can.LogReader(path))))
        replaying.append(seconds(lambda: replay_log(path, ReplaySettings((CONFIG,)))))
    ratios = [ours / theirs for ours, theirs in zip(replaying, reading, strict=True)]
    return {
        "frames": count,
        "python_can_us": 1e6 * statistics.median(reading) / count,
        "replay_us": 1e6 * statistics.median(replaying) / count,
        "ratio": statistics.median(ratios),
        "ratio_least": min(ratios),
        "ratio_most": max(ratios),
    }


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--cycles", type=int, default=8000)
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args(arguments)
    found: dict[str, dict[str, float]] = {}
    with tempfile.TemporaryDirectory() as folder:
        for kind in KINDS:
            log = frames(kind, options.cycles)
            for suffix in SUFFIXES:
                path = Path(folder) / f"bench{suffix}"
                write(path, log)
                found[f"{kind}, {suffix}"] = compare(path, options.repeat)
    if options.json:
        print(json.dumps(found, indent=2))
        return 0
    print(f"{'log':28}{'python-can':>12}{'replay':>10}  us/frame   ratio (allowed {ALLOWED_RATIO})")
    for name, one in found.items():
        print(
            f"{name:28}{one['python_can_us']:12.2f}{one['replay_us']:10.2f}"
            f"{one['ratio']:18.2f}  {one['ratio_least']:.2f} to {one['ratio_most']:.2f}"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
