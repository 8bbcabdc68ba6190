"""The frames of a bus: worst-case length, rate, load, and delay of a SYNC.

:class:`PlannedModule` is a module, described by its objects, configured or saved; :func:`laid_out` changes
the layout of the RPDOs with its samples.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

from canfb import objects as od
from canfb.cia301 import cob
from canfb.cia301.frame import frame_bits, mapping_values
from canfb.device.od.dcf import Place
from canfb.device.pdo.mapping import EVENT_DRIVEN, SYNCHRONOUS
from canfb.module.cia406.alarms import SHORTEST_S
from canfb.simulation.embedded_bus import LONGEST_FRAME_BITS
from canfb.view.module_view import MODULE_PAIRS, LimitSettings, Pdo, limit_settings, valid_pdos

Values = Mapping[Place, Any]  # Objects of a node by index and sub-index.

HEARTBEAT = (0x1017, 0)
EMCY_COB_ID, EMCY_INHIBIT = (0x1014, 0), (0x1015, 0)
EMCY_BYTES = 8
MOST_EMCY_HZ = 2.0 / SHORTEST_S  # if the alarm of the position appears and ends as often as possible
INHIBIT_S, TIMER_S = 1e-4, 1e-3  # units of sub-indices 3 and 5 of a TPDO, and of 1015h and 1017h


@dataclass(frozen=True, kw_only=True)
class Message:
    """The frames of one COB-ID.

    kind          description, for messages
    node_id       sender; None: the producer of SYNC
    data_bytes    0..8
    each_syncs    SYNCs per frame; None: not by SYNC
    least_hz      rate without SYNC: event timer, heartbeat
    most_hz       highest rate, by the inhibit time
    on_error      only after a fault: counts for the load, but does not delay a SYNC of a healthy network
    """

    can_id: int
    kind: str
    data_bytes: int
    node_id: int | None = None
    each_syncs: int | None = None
    least_hz: float = 0.0
    most_hz: float = math.inf
    on_error: bool = False

    @property
    def what(self) -> str:
        return self.kind if self.node_id is None else f"{self.kind}, node {self.node_id:02X}h"

    @property
    def bits(self) -> int:
        """Bits on the wire, with the most stuff bits and the interframe space."""
        return frame_bits(self.data_bytes)

    def rate_hz(self, sync_hz: float) -> float:
        by_sync = 0.0 if self.each_syncs is None else sync_hz / self.each_syncs
        # An event timer restarts with each frame: it never expires if frames come faster by SYNC.
        timed = self.least_hz if self.least_hz >= by_sync else 0.0
        return min(by_sync + timed, self.most_hz)

    def bits_per_s(self, sync_hz: float) -> float:
        return self.bits * self.rate_hz(sync_hz)

    def follows_sync(self, sync_hz: float) -> bool:
        """Whether all its frames are sent just after a SYNC."""
        return self.each_syncs is not None and self.rate_hz(sync_hz) == sync_hz / self.each_syncs


def sync_message(values: Values) -> Message:
    return Message(
        can_id=values.get(od.SYNC_COB_ID, cob.SYNC) & cob.CAN_ID,
        kind="SYNC",
        data_bytes=1 if values.get(od.SYNCHRONOUS_COUNTER_OVERFLOW) else 0,
        each_syncs=1,
    )


def adc_messages(values: Values) -> list[Message]:
    found = []
    for pdo in valid_pdos(values.get, od.RPDO, od.RPDO_MAPPING):
        kind, sender = f"for RPDO{pdo.number}", 0
        if pdo.number == 1 or pdo.carries(od.SAMPLE_SINE.object_index):
            kind = "ADC PDO" if pdo.number == 1 else f"ADC PDO {pdo.number}"
            sender = pdo.can_id - cob.TPDOS[pdo.number - 1]
        found.append(
            Message(
                can_id=pdo.can_id,
                kind=kind,
                node_id=sender if 1 <= sender <= 127 else None,
                data_bytes=pdo.length_bytes,
                each_syncs=1,
            )
        )
    return found


def node_messages(values: Values, node_id: int, *, sampled: bool, heartbeat_s: float = 0.0) -> list[Message]:
    """TPDOs, heartbeat and EMCY of a node; ``heartbeat_s`` if it has none of its own, 0.0: none.

    ``sampled``: each sample is an event for its TPDOs of types 0, FEh and FFh. TPDOs that are sent on remote
    frames only have the rate 0.
    """
    found = [_tpdo(values, pdo, node_id, sampled) for pdo in valid_pdos(values.get, od.TPDO, od.TPDO_MAPPING)]
    period_s = values.get(HEARTBEAT, 0) * TIMER_S or heartbeat_s
    if period_s:
        found.append(
            Message(
                can_id=cob.ERROR_CONTROL + node_id,
                kind="heartbeat",
                node_id=node_id,
                data_bytes=1,
                least_hz=1.0 / period_s,
            )
        )
    emcy = values.get(EMCY_COB_ID, cob.EMERGENCY + node_id)
    if cob.is_valid(emcy):
        inhibit = values.get(EMCY_INHIBIT, 0) * INHIBIT_S
        found.append(
            Message(
                can_id=emcy & cob.CAN_ID,
                kind="EMCY, at worst",
                node_id=node_id,
                data_bytes=EMCY_BYTES,
                least_hz=min(MOST_EMCY_HZ, 1.0 / inhibit if inhibit else math.inf),
                on_error=True,
            )
        )
    return found


def _tpdo(values: Values, pdo: Pdo, node_id: int, sampled: bool) -> Message:
    def parameter(subindex: int) -> int:
        return int(values.get((od.TPDO + pdo.number - 1, subindex), 0))

    kind, inhibit, timer = parameter(2), parameter(3) * INHIBIT_S, parameter(5) * TIMER_S
    event_driven = kind in EVENT_DRIVEN
    each = max(1, kind) if kind in SYNCHRONOUS else 1 if event_driven and sampled else None
    return Message(
        can_id=pdo.can_id,
        kind=f"TPDO{pdo.number}, type {kind}",
        node_id=node_id,
        data_bytes=pdo.length_bytes,
        each_syncs=each,
        least_hz=1.0 / timer if event_driven and timer else 0.0,
        most_hz=1.0 / inhibit if event_driven and inhibit else math.inf,
    )


# Bit rates of CiA 301, bit/s.
BIT_RATES = (10_000, 20_000, 50_000, 125_000, 250_000, 500_000, 800_000, 1_000_000)
_HALVINGS = 60


@dataclass(frozen=True)
class BusLoad:
    """The frames of a bus of ``bit_rate`` bit/s with a SYNC of ``sync_hz``.

    ``extra_load`` is the bus load of other nodes, 0..1, by frames of up to 8 bytes at any time. Every frame
    counts with the most stuff bits.
    """

    bit_rate: int
    sync_hz: float
    messages: tuple[Message, ...]
    extra_load: float = 0.0

    @cached_property
    def load(self) -> float:
        """Bus load, above 1.0 if the bus cannot transmit all frames."""
        return self.load_at(self.sync_hz)

    def load_at(self, sync_hz: float) -> float:
        return sum(message.bits_per_s(sync_hz) for message in self.messages) / self.bit_rate + self.extra_load

    @cached_property
    def largest_sync_hz(self) -> float:
        """The SYNC rate at which the load is 1.0; 0.0 if other frames alone fill the bus."""
        low, high = 0.0, float(self.bit_rate)  # upper bound: a frame has more than one bit
        if self.load_at(low) >= 1.0:
            return 0.0
        for _ in range(_HALVINGS):
            middle = (low + high) / 2.0
            low, high = (middle, high) if self.load_at(middle) <= 1.0 else (low, middle)
        return low

    @cached_property
    def longest_turn_s(self) -> float:
        """Time from a SYNC until all frames that follow it are transmitted."""
        bits = sum(message.bits for message in self.messages if message.follows_sync(self.sync_hz))
        return (bits + self._free_bits()) / self.bit_rate

    @cached_property
    def sync_delay_s(self) -> float:
        """Longest wait of a SYNC: for the longest frame that may be on the wire."""
        late = self.longest_turn_s * self.sync_hz > 1.0
        longest = max((message.bits for message in self.messages), default=0) if late else self._free_bits()
        return longest / self.bit_rate

    def _free_bits(self) -> int:
        free = [
            message.bits
            for message in self.messages
            if not message.on_error
            and message.rate_hz(self.sync_hz) > 0.0
            and not message.follows_sync(self.sync_hz)
        ]
        return max([*free, LONGEST_FRAME_BITS if self.extra_load > 0.0 else 0])


def in_order(messages: Iterable[Message]) -> tuple[Message, ...]:
    """The first message of each CAN-ID, by priority."""
    found = {message.can_id: message for message in reversed([*messages])}  # reversed: the first one wins
    return tuple(sorted(found.values(), key=lambda one: one.can_id))


TIME = od.SAMPLE_TIME.mapped(32)


def _of_samples(values: Values) -> list[Pdo]:
    return [
        pdo
        for pdo in valid_pdos(values.get, od.RPDO, od.RPDO_MAPPING)
        if pdo.carries(od.SAMPLE_SINE.object_index)
    ]


def laid_out(values: Values, pairs: int, times: bool) -> dict[Place, Any]:
    """Objects of RPDOs for ``pairs``, 1..8 per SYNC, with the time of the newest if ``times``.

    Other mapped objects are kept. RPDOs of the same interface are used first, then free ones. ValueError if
    there are too few.
    """
    pdos = _of_samples(values)
    tracks = next((pdo for pdo in pdos if set(MODULE_PAIRS[0]) <= set(pdo.entries)), None)
    if tracks is None:
        raise ValueError("samples_per_sync needs an RPDO that brings 2000:01 and 2000:02")
    interface = tracks.can_id & cob.NODE_ID
    own = [pdo for pdo in pdos if pdo.can_id & cob.NODE_ID == interface]
    entries = [entry for pair in MODULE_PAIRS[:pairs] for entry in pair]
    entries += [TIME] if times else []
    known = {TIME}.union(*MODULE_PAIRS)
    entries += [entry for pdo in own for entry in pdo.entries if entry not in known]
    mapped = mapping_values(0, entries)  # keys: index of the PDO in ``numbers``, sub-index
    in_use = {pdo.number for pdo in valid_pdos(values.get, od.RPDO, od.RPDO_MAPPING)}
    cob_ids = {n: (od.RPDO + n - 1, 1) for n in range(1, len(cob.TPDOS) + 1)}
    free = [n for n, place in cob_ids.items() if n not in in_use and place in values]
    numbers, needed = [*(pdo.number for pdo in own), *free], 1 + max(place for place, _ in mapped)
    if needed > len(numbers):
        raise ValueError(f"the samples need {needed} RPDOs, and there are {len(numbers)} for them")
    return {
        **{(od.RPDO_MAPPING + numbers[place] - 1, sub): value for (place, sub), value in mapped.items()},
        **{cob_ids[n]: cob.TPDOS[n - 1] + interface for n in numbers[len(own) : needed]},
        **{cob_ids[pdo.number]: cob.NOT_VALID | values[cob_ids[pdo.number]] for pdo in own[needed:]},
    }


@dataclass(frozen=True, kw_only=True)
class PlannedModule:
    """A feedback module.

    node_id           1..127
    values            its objects, as a master would write them; its ADC PDOs also if it samples itself
    has_table         a correction table is in force
    samples_itself    it has a source instead of the ADC PDO
    """

    node_id: int
    values: Values = field(repr=False)
    has_table: bool = False
    samples_itself: bool = False

    @cached_property
    def settings(self) -> LimitSettings:
        return limit_settings(self.values.get)

    @cached_property
    def times(self) -> bool:
        return self.samples_itself or self.settings.timed

    @property
    def sample_bytes(self) -> int:
        return 0 if self.samples_itself else sum(pdo.length_bytes for pdo in _of_samples(self.values))

    def with_values(self, values: Mapping[Place, Any]) -> PlannedModule:
        return replace(self, values={**self.values, **values})

    def with_samples(self, per_sync: int, *, times: bool) -> PlannedModule:
        """With ``samples_per_sync``, 1..8, and ``times``, unless it samples itself.

        ValueError without room in the RPDOs.
        """
        if self.samples_itself or (per_sync, times) == (self.settings.samples_per_sync, self.times):
            return self
        return self.with_values(laid_out(self.values, per_sync, times))
