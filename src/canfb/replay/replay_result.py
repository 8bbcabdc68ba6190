"""Result of a replay as rows, for text and JSON (:mod:`canfb.rows`)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from canfb.replay.findings import KINDS, Extreme, LogDrift
from canfb.replay.module_replay import Begin, ModuleReplay, OwnFrames
from canfb.rows import Row, as_figures, as_lines, finite, those
from canfb.signal.limits import RPM

SHOWN_FAULTS = 10
MOVES_CYCLES = 0.1  # distance over the first samples that is more than noise
# For each margin: name, unit, factor that converts to it, format.
MARGINS = {
    "residual": ("residual", "cycles", 1.0, ".4f"),
    "amplitude_low": ("lowest amplitude", "counts", 1.0, ".0f"),
    "amplitude_high": ("highest amplitude", "counts", 1.0, ".0f"),
    "acceleration_cycles": ("acceleration", "cycles per interval²", 1.0, ".4f"),
    "speed_rad_s": ("speed", "rpm", RPM, ".1f"),
}
COUNTED = {
    "equal": "equal",
    "different": "different",
    "only_recorded": "only in the log",
    "only_replayed": "only in the replay",
}


@dataclass(frozen=True)
class ReplayResult:
    """One module of a log. Times in JSON are stamps of the log, in text seconds from its beginning.

    drift      None if it was not measured
    left_out   frames of this module on channels of the log that were not selected
    """

    replay: ModuleReplay
    drift: LogDrift | None
    left_out: int

    def head(self) -> str:
        node_id, replay = self.replay.module.node_id, self.replay
        seconds = replay.last_s - replay.first_s
        return f"module {node_id} ({node_id:02X}h): {replay.frames} frames, {seconds:.3f} s"

    def figures(self) -> dict[str, Any]:
        return as_figures([self._verdict()], self.facts())

    def lines(self) -> list[str]:
        more = sum(self.replay.faults.times.values()) - SHOWN_FAULTS
        rows = [
            *(Row("note", text) for text in self.notes()),
            self._verdict(),
            *self.facts(),
            *(Row("fault", text) for text in self.faults()[:SHOWN_FAULTS]),
            Row("", f"... and {more} more" if more > 0 else None),
            *self.comparison(),
        ]
        return [self.head(), *as_lines(rows)]

    def notes(self) -> list[str]:
        """Reasons, other than errors, why the replay may differ from the recorded module."""
        replay, compared, module = self.replay, self.replay.compared, self.replay.module
        changed = ", ".join(sorted({name for one in compared.values() for name in one.uploads}))
        more = replay.emergencies - sum(
            one.equal + one.different + one.only_recorded
            for can_id, one in compared.items()
            if can_id == replay.emergency_id
        )
        moves = replay.begin is not Begin.BOOT_UP and replay.margins.begin_cycles > MOVES_CYCLES
        return those(
            (
                module.counters.long_rpdos and not module.config.times,
                "the ADC PDOs are longer than their mapping: do they carry sample times (--set times=true)?",
            ),
            (
                module.counters.short_rpdos and module.config.times,
                "the ADC PDOs are shorter than their mapping: do they lack sample times (--set times=false)?",
            ),
            (
                moves,
                "the log begins in motion, after the start of the module: --begin, docs/monitor.md",
            ),
            (changed, f"the recorded module had other values in {changed}: --config or --state"),
            (
                compared and more > 0 and not changed,
                f"{more} EMCY are not in the log: were the limits different (--config, --state)?",
            ),
        )

    def verdict(self) -> str:
        faults = self.replay.faults
        left_out = f"; {self.left_out} frames with CAN-IDs of this module were left out (--channel)"
        missing = left_out if self.left_out else ""
        samples = self.replay.samples.rows - faults.samples["missed"]
        if not samples:
            return f"the module received no sample: check --encoder-interface, --begin and --channel{missing}"
        bad = [f"{times} × {kind}" for kind, times in faults.times.items() if times]
        found = ", ".join(bad) if bad else "none in the samples used" if missing else "none"
        return f"{samples} samples; faults: {found}{missing}"

    def _verdict(self) -> Row:
        replay, faults = self.replay, self.replay.faults
        return Row(
            "samples",
            self.verdict(),
            node_id=replay.module.node_id,
            first_s=replay.first_s,
            last_s=replay.last_s,
            left_out=self.left_out,
            samples=replay.samples.rows - faults.samples["missed"],
            faults={kind: {"times": faults.times[kind], "samples": faults.samples[kind]} for kind in KINDS},
            table_crc32=f"{replay.module.chain.correction.crc32:08X}",
            sent=replay.sent,
            compared={f"{can_id:03X}h": _compared(one) for can_id, one in replay.compared.items()},
            acceleration_rad_s2=replay.margins.acceleration_rad_s2,
            notes=self.notes(),
            margins={
                name: {key: finite(value) for key, value in one._asdict().items()}
                for name, one in replay.margins.nearest.items()
            },
        )

    def faults(self) -> list[str]:
        return [
            f"{fault.begin_s - self.replay.first_s:.6f} s: {fault.kind}, {fault.samples} "
            f"{'interval' if fault.samples == 1 else 'intervals'}"
            for fault in sorted(self.replay.faults.listed, key=lambda fault: (fault.begin_s, fault.kind))
        ]

    def facts(self) -> list[Row]:
        replay, drift = self.replay, self.drift
        margins = [
            Row(MARGINS[name][0], self._margin(one, *MARGINS[name][1:]))
            for name, one in replay.margins.nearest.items()
        ]
        moved = Row(
            "drift from the table",
            None if drift is None else _drift_words(drift),
            drift=drift
            and {
                "rms_cycles": finite(drift.rms),
                "peak_cycles": finite(drift.peak),
                "uncertainty_rms_cycles": finite(drift.uncertainty_rms),
                "reason": drift.reason,
            },
        )
        odd = (
            ("restarts", "restarts", replay.restarts, "power-ups of the recorded module within the log"),
            ("clock", "steps_back", replay.steps_back, "times the clock of the log was set back"),
            ("gaps", "gaps", replay.gaps, "silences of more than a minute, each replayed as one of a minute"),
            ("time stamps", None, replay.bad_stamps, "that are not numbers"),
            ("EMCY", "emergencies", replay.emergencies, "sent"),
        )
        counts = [
            Row(name, f"{count} {text}" if count else None, **({key: count} if key else {}))
            for name, key, count, text in odd
        ]
        return [*margins, moved, *counts]

    def _margin(self, found: Extreme, unit: str, factor: float, form: str) -> str | None:
        if math.isnan(found.value):
            return None
        value = f"{found.value * factor:{form}}"
        limit = f" of {found.limit * factor:{form}}" if math.isfinite(found.limit) else ""
        left = f"; margin {100.0 * found.margin:.0f} %" if limit and math.isfinite(found.margin) else ""
        return f"{value}{limit} {unit} at {found.time_s - self.replay.first_s:.3f} s{left}"

    def comparison(self) -> list[Row]:
        rows: list[Row] = []
        for can_id, found in self.replay.compared.items():
            counts = {words: getattr(found, name) for name, words in COUNTED.items()}
            said = [f"{count} {words}" for words, count in counts.items() if count or words == "equal"]
            rows.append(Row(f"recorded {can_id:03X}h", ", ".join(said)))
            if found.first is not None:
                time_s, recorded, replayed = found.first
                at = f"first at {time_s - self.replay.first_s:.6f} s"
                rows.append(Row("", f"{at}: {recorded.hex()} recorded, {replayed.hex()} replayed"))
            for one in found.differences:
                if one.pairs:
                    how = f"{one.least:g}" if one.least == one.most else f"{one.least:g} to {one.most:g}"
                    rows.append(Row("", f"{one.name} differs by {how}"))
        return rows


def _compared(found: OwnFrames) -> dict[str, Any]:
    words: dict[str, Any] = {name: getattr(found, name) for name in COUNTED}
    if found.first is not None:
        time_s, recorded, replayed = found.first
        words["first_different"] = {
            "time_s": time_s,
            "recorded": recorded.hex(),
            "replayed": replayed.hex(),
        }
    if found.differences:
        words["objects"] = {
            one.name: {"pairs": one.pairs, "least": finite(one.least), "most": finite(one.most)}
            for one in found.differences
        }
    return words


def _drift_words(drift: LogDrift) -> str:
    if drift.reason is not None:
        return f"not seen: {drift.reason}"
    return (
        f"{100.0 * drift.rms:.3f} % rms, {100.0 * drift.peak:.3f} % peak of a cycle, known to "
        f"{100.0 * drift.uncertainty_rms:.3f} %"
    )
