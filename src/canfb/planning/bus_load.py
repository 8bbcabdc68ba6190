"""All frames of a bus: its load at worst, the largest SYNC rate, and what delays a SYNC."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

from canfb.planning.traffic import Message
from canfb.simulation.wire import LONGEST_FRAME_BITS

BIT_RATES = (10_000, 20_000, 50_000, 125_000, 250_000, 500_000, 800_000, 1_000_000)
"""Bit rates of CiA 301, bit/s."""
_HALVINGS = 60


@dataclass(frozen=True)
class BusLoad:
    """The frames of a bus of ``bit_rate`` bit/s with a SYNC of ``sync_hz``.

    ``extra_load`` is the part of the time that frames of other nodes take, 0..1, each up to 8 bytes long,
    at any time. Every frame counts with the most stuff bits that there can be.
    """

    bit_rate: int
    sync_hz: float
    messages: tuple[Message, ...]
    extra_load: float = 0.0

    @cached_property
    def load(self) -> float:
        """Part of the time for which the bus is busy, above 1.0 if it cannot carry the frames."""
        return self.load_at(self.sync_hz)

    def load_at(self, sync_hz: float) -> float:
        """:attr:`load` with another SYNC rate."""
        bits = sum(message.bits_per_s(sync_hz) for message in self.messages)
        return bits / self.bit_rate + self.extra_load

    @cached_property
    def largest_sync_hz(self) -> float:
        """The SYNC rate at which the load is 1.0; 0.0 if other frames alone fill the bus."""
        low, high = 0.0, float(self.bit_rate)  # no frame is shorter than a bit
        if self.load_at(low) >= 1.0:
            return 0.0
        for _ in range(_HALVINGS):
            middle = (low + high) / 2.0
            low, high = (middle, high) if self.load_at(middle) <= 1.0 else (low, middle)
        return low

    @cached_property
    def longest_turn_s(self) -> float:
        """From a SYNC that is due until all frames that follow one are through, if all come at once."""
        bits = sum(message.bits for message in self.messages if message.follows_sync(self.sync_hz))
        return (bits + self._free_bits()) / self.bit_rate

    @cached_property
    def sync_delay_s(self) -> float:
        """Longest wait of a SYNC for the bus: the longest frame that may be on the wire when it is due."""
        late = self.longest_turn_s * self.sync_hz > 1.0
        longest = max((message.bits for message in self.messages), default=0) if late else self._free_bits()
        return longest / self.bit_rate

    def _free_bits(self) -> int:
        """The longest frame that may be on the wire at any time."""
        free = [
            message.bits
            for message in self.messages
            if not message.on_error
            and message.rate_hz(self.sync_hz) > 0.0
            and not message.follows_sync(self.sync_hz)
        ]
        return max([*free, LONGEST_FRAME_BITS if self.extra_load > 0.0 else 0])


def in_order(messages: Iterable[Message]) -> tuple[Message, ...]:
    """Each CAN-ID once, as it is sent once; by priority, what is of many last."""
    found: dict[int | None, Message] = {}
    for message in messages:
        found.setdefault(message.can_id, message)
    return tuple(sorted(found.values(), key=lambda one: 0x800 if one.can_id is None else one.can_id))
