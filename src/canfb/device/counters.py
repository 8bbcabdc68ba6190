"""What the device dropped or refused, counted since it was made."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(slots=True)
class Counters:
    """Frames and values from the bus that had no effect, by reason. Never reset, never wrap."""

    unknown_cob_ids: int = 0
    """Frames that no service listens to in the present NMT state; frames for others included."""
    malformed_frames: int = 0
    """More than 8 bytes, a CAN-ID above 7FFh, or a length or content that the service cannot mean."""
    remote_frames: int = 0
    """Remote frames where none is meant, or on a TPDO that allows none."""
    duplicate_frames: int = 0
    """Data frames with a CAN-ID that only this node may send: another has its node-ID or COB-ID."""
    short_rpdos: int = 0
    """RPDOs shorter than their mapping; the data was kept."""
    long_rpdos: int = 0
    """RPDOs longer than their mapping; the mapped part was used."""
    late_rpdos: int = 0
    """Synchronous RPDOs after the synchronous window (1007h)."""
    refused_rpdo_values: int = 0
    """Mapped values beyond the limits of their entry, or refused by it."""
    sdo_aborts: int = 0
    """SDO aborts that were sent."""
    lost_emergencies: int = 0
    """EMCY frames dropped for newer ones while sending was not allowed."""
