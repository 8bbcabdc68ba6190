"""The second act: a move of a servo, with several samples for each SYNC and with one."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from canfb.demo.demo_network import SYNC_PERIOD_S, DemoNetwork
from canfb.signal.correction import Correction
from canfb.signal.feedback import Feedback
from canfb.signal.phase import FloatArray
from canfb.simulation.encoder import Encoder
from canfb.simulation.motion import SCurve

RPM, ACCELERATION_RAD_S2, JERK_RAD_S3 = 3000.0, 7850.0, 785_000.0
AT_REST_S = 0.15  # the clocks of interface and module lock to SYNC
AT_SPEED_S = 0.03
MOST_RESIDUAL_CYCLES = 0.28  # acceleration 0.195, sample times at 3000 rpm at most 0.05, table and noise 0.01
WRONG_CYCLES = 0.25
# Samples for each SYNC: those that count the move, and what others make of it.
WAYS = (4, 2, 1)


@dataclass
class ServoRun:
    """What came of the move.

    limit_cycles        residual limit in force at the end
    time_s, residual    of each sample, seconds from the start of the move, cycles
    valid               every position was valid from the first sample on
    cycles_off          by how many cycles the position was wrong at the end
    wrong_and_valid     positions published as valid that were off by more than a quarter of a cycle
    """

    samples_per_sync: int
    time_s: FloatArray = field(default_factory=lambda: np.zeros(0))
    residual: FloatArray = field(default_factory=lambda: np.zeros(0))
    valid: bool = False
    cycles_off: int = 0
    limit_cycles: float = 0.0
    wrong_and_valid: int = 0

    @property
    def exact(self) -> bool:
        return self.valid and not self.cycles_off and not self.wrong_and_valid

    @property
    def largest_residual(self) -> float:
        return float(self.residual.max(initial=0.0))

    @property
    def name(self) -> str:
        samples = {1: "one sample", 2: "two samples", 4: "four samples"}[self.samples_per_sync]
        return f"{samples} for each SYNC"

    @property
    def outcome(self) -> str:
        if self.exact:
            return f"counted exactly, largest residual {self.largest_residual:.3f} cycle"
        return f"lost, {abs(self.cycles_off)} cycles off"

    def figures(self) -> dict[str, Any]:
        return {
            "samples_per_sync": self.samples_per_sync,
            "counted_exactly": self.exact,
            "largest_residual_cycles": self.largest_residual,
            "residual_limit_cycles": self.limit_cycles,
            "cycles_off": self.cycles_off,
            "wrong_positions_called_valid": self.wrong_and_valid,
        }


def servo_move(encoder: Encoder, correction: Correction, seed: int) -> list[ServoRun]:
    return [_run(encoder, correction, seed, ServoRun(way)) for way in WAYS]


def _run(encoder: Encoder, correction: Correction, seed: int, run: ServoRun) -> ServoRun:
    move = SCurve(RPM * 2.0 * math.pi / 60.0, ACCELERATION_RAD_S2, JERK_RAD_S3, AT_REST_S)
    network = DemoNetwork(encoder, seed, move, run.samples_per_sync)
    module, source = network.module, network.source
    module.use_correction(correction)
    feedbacks: list[tuple[float, Feedback]] = []
    away: list[float] = []

    def listen(feedback: Feedback, now: float) -> None:
        """With each SYNC: all its samples, each in its part of the interval."""
        all_of_it = (*module.chain.between, feedback)
        apart_s = SYNC_PERIOD_S / run.samples_per_sync
        begin = source.machine_time(now) - AT_REST_S - SYNC_PERIOD_S
        feedbacks.extend((begin + (k + 1) * apart_s, one) for k, one in enumerate(all_of_it))
        away.append(feedback.cycles + feedback.phase - source.position_cycles)

    module.on_feedback = listen
    network.canopen.nmt.state = "OPERATIONAL"  # all nodes
    network.drive.start_sync(network.bus.now)
    network.bus.run_until(network.bus.now + SYNC_PERIOD_S * 2 + move.end_s + AT_SPEED_S)
    run.limit_cycles = module.limits.residual_limit
    return _judged(run, feedbacks, away)


def _judged(run: ServoRun, feedbacks: list[tuple[float, Feedback]], away: list[float]) -> ServoRun:
    """The zero of the count is where the module started: in the cycle in which it stood."""
    error = np.array(away) - away[0]
    newest = [one for _, one in feedbacks][run.samples_per_sync - 1 :: run.samples_per_sync]
    run.time_s = np.array([time for time, _ in feedbacks])
    run.residual = np.array([one.residual for _, one in feedbacks])
    run.valid = all(one.valid for _, one in feedbacks)
    wrong = np.abs(error) > WRONG_CYCLES
    run.wrong_and_valid = int(np.count_nonzero(wrong & [one.valid for one in newest]))
    run.cycles_off = round(float(error[-1]))
    return run
