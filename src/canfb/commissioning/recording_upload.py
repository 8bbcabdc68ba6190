"""Samples of a recording object (2050h): faster than SYNC in the encoder interface, or the module's."""

from __future__ import annotations

from collections.abc import Callable

from canfb import objects as od
from canfb.commissioning.access import CommissioningError, NodeAccess, ObjectAbsentError
from canfb.commissioning.samples import TrackSamples
from canfb.objects import RecordingCommand as Command

LOOK_S = 0.2
STANDING_S = 1.0  # no more samples for this long: the memory of the node is full
EMPTY_S = 2.0  # none at all for this long: nothing samples
UPLOAD_PART = 0.5  # of the progress reported


def record(
    node: NodeAccess, duration_s: float, rate_hz: float | None, heard: Callable[[float], None]
) -> TrackSamples:
    """Let ``node`` record for ``duration_s`` seconds and upload what it has; ``heard`` gets 0..1.

    The rate is that of 2050:04 where the node has it, else ``rate_hz``. The recording is stopped in any
    case. CommissioningError if the node cannot record, or has recorded nothing.
    """
    try:
        node.write(*od.RECORDING_COMMAND, "B", Command.START)
    except ObjectAbsentError:
        raise CommissioningError(f"{node.name} cannot record: it has no object 2050h") from None
    try:
        _wait(node, duration_s, heard)
    finally:
        node.write(*od.RECORDING_COMMAND, "B", Command.STOP)
    count = node.integer(*od.RECORDING_RECORDED, "I")
    if not count:
        raise CommissioningError(f"{node.name} has recorded nothing (2050:02): is it OPERATIONAL?")
    data = node.upload_domain(
        *od.RECORDING_SAMPLES, lambda part: heard(UPLOAD_PART + (1.0 - UPLOAD_PART) * part)
    )
    return TrackSamples.from_bytes(data, _rate(node) or rate_hz, f"recording 2050h of {node.name}")


def _wait(node: NodeAccess, duration_s: float, heard: Callable[[float], None]) -> None:
    master = node.master
    began = grown = master.now()
    count = 0
    while (passed := master.now() - began) < duration_s:
        heard(UPLOAD_PART * passed / duration_s)
        master.wait(min(LOOK_S, duration_s - passed))
        now_there = node.integer(*od.RECORDING_RECORDED, "I")
        if now_there != count:
            count, grown = now_there, master.now()
        elif master.now() - grown > (STANDING_S if count else EMPTY_S):
            return  # the memory is full, or nothing samples


def _rate(node: NodeAccess) -> float | None:
    try:
        return float(node.integer(*od.RECORDING_RATE, "I")) or None
    except CommissioningError:
        return None
