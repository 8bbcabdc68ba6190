"""The report of a replay: one HTML file that stands alone."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from canfb.files import writing
from canfb.logfile.log_reader import BusLogFile
from canfb.replay.findings import Overview
from canfb.replay.module_replay import ModuleReplay
from canfb.replay.replay_result import RPM, ReplayResult
from canfb.report.page import beside, figure, gallery, page, table
from canfb.report.pictures import Curve, lissajous, over_time
from canfb.rows import Row

MOST_FAULTS = 40


def write_page(path: Path, log: BusLogFile, result: ReplayResult, overview: Overview) -> None:
    replay = result.replay
    whole = not (result.left_out or log.counters.damaged_lines or log.trouble)
    tables = table("Margins", [*result.facts(), *log.counters.facts(log.trouble)])
    compared = result.comparison()
    if compared:
        tables += table("The recorded module and the replay", compared)
    conditioning = replay.module.chain.correction.conditioning
    picture = lissajous(overview.sine, overview.cosine, conditioning, replay.module.limits.sample)
    shown = figure("Lissajous figure", f"{len(overview.sine)} samples, evenly chosen", picture)
    body = beside(tables, shown) + gallery("Over time", _pictures(replay, overview))
    faults = result.faults()
    if faults:
        rows = [Row(f"{n}", text) for n, text in enumerate(faults[:MOST_FAULTS], 1)]
        more = sum(replay.faults.times.values()) - MOST_FAULTS
        body += table("Faults", [*rows, Row("", f"and {more} more" if more > 0 else None)])
    other = any(one.different or one.only_recorded or one.only_replayed for one in replay.compared.values())
    good = whole and not other and not any(replay.faults.times.values())
    said = [f"{one[:1].upper()}{one[1:]}." for one in (*result.notes(), result.verdict())]
    text = page(f"Replay of {log.path.name}", result.head(), said, body, "Margin: what is left of it", good)
    with writing(path, "--report"):
        path.write_text(text, encoding="utf-8")


def _pictures(replay: ModuleReplay, overview: Overview) -> list[str]:
    found = overview.stretches
    time_s = found["begin_s"] - replay.first_s
    if not len(time_s):
        return []
    residual = [
        Curve(found["residual"], "after", "largest residual"),
        Curve(found["residual_limit"], "limit dashed", "limit"),
    ]
    amplitude = [
        Curve(found["amplitude_least"], "after", "lowest"),
        Curve(found["amplitude_most"], "before", "highest"),
        Curve(found["amplitude_low_counts"], "limit dashed", "limits"),
        Curve(found["amplitude_high_counts"], "limit dashed", None),
    ]
    speed = [
        Curve(RPM * found["speed_most"], "before", "highest"),
        Curve(RPM * found["speed_least"], "after", "lowest"),
    ]
    faults = [
        Curve(np.where(found["faults"] > 0.0, found["faults"], 0.0), "before", "intervals with a fault")
    ]
    stretch = f"in each of {len(time_s)} equal parts of the log"
    extremes = f"lowest and highest {stretch}"
    return [
        figure("Residual", f"largest {stretch}", over_time("Residual", "cycles", time_s, residual, 0.0)),
        figure("Amplitude", extremes, over_time("Amplitude", "counts", time_s, amplitude, 0.0)),
        figure("Speed", f"{extremes}, while valid", over_time("Speed", "rpm", time_s, speed)),
        figure("Faults", f"intervals {stretch}", over_time("Faults", "intervals", time_s, faults, 0.0)),
    ]
