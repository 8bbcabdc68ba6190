"""What there was in a bus log, beside the frames that count."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass
class LogCounters:
    """All frames, those left out and why, and lines that are none.

    bytes_read       of the file, for the progress
    channel          whose frames were taken; None before the first one
    other_channels   whose were not
    not_canopen      29-bit identifiers and CAN FD
    """

    frames: int = 0
    error_frames: int = 0
    not_canopen: int = 0
    damaged_lines: int = 0
    first_damaged_line: int = 0
    bytes_read: int = 0
    channel: str | None = None
    other_channels: set[str] = field(default_factory=set)
