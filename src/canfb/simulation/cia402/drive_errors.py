"""Error codes of the drive: 603Fh, and the EMCY that goes with it (CiA 402, error codes)."""

from __future__ import annotations

from enum import IntEnum


class DriveError(IntEnum):
    """Why there is a fault."""

    NONE = 0x0000
    INCREMENTAL_SENSOR = 0x7305  # the feedback says that it is not valid, or is missing
    POSITION_SENSOR = 0x7320  # a position that cannot be
    COMMUNICATION = 0x8100  # NMT has taken the drive out of Operational
    HEARTBEAT = 0x8130
    FOLLOWING_ERROR = 0x8611
    SYNC_CONTROLLER = 0x8700  # no SYNC
