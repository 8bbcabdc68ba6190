"""What there was in a bus log, beside the frames that count."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field


@dataclass
class LogCounters:
    """All frames, those left out and why, and lines that are none.

    bytes_read       of the file, for the progress
    channels         whose frames were taken
    left_out         frames of other channels with 11-bit identifiers: by channel, by CAN-ID
    not_canopen      29-bit identifiers and CAN FD
    """

    frames: int = 0
    error_frames: int = 0
    not_canopen: int = 0
    damaged_lines: int = 0
    first_damaged_line: int = 0
    bytes_read: int = 0
    channels: set[str] = field(default_factory=set)
    left_out: dict[str, Counter[int]] = field(default_factory=dict)

    def leave_out(self, channel: str, can_ids: Counter[int]) -> None:
        """So many more frames of a channel that is not the chosen one."""
        self.left_out.setdefault(channel, Counter()).update(can_ids)
