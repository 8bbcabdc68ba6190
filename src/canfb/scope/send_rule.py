"""Frames that ``canfb scope`` may send: none, SDO uploads, or all that its tasks need."""

from __future__ import annotations

from enum import Enum

from canfb.cia301 import cob

READING = (2, 3, 4, 5)
"""Client command specifiers that do not download: upload, segments, abort, block (CiA 301, 7.2.4.3)."""
LOWEST_NODE, HIGHEST_NODE, SDO_BYTES = 1, 127, 8


class SendRule(Enum):
    """Asked for each frame before it goes to the bus."""

    NOTHING = "canfb scope only listens: start it with --sdo or --write"
    READS = "this only reads: canfb scope sends what writes with --write, for the tasks that say so"
    ALL = ""

    def permits(self, can_id: int, data: bytes) -> bool:
        """Whether a data frame may be sent."""
        if self is not SendRule.READS:
            return self is SendRule.ALL
        node = can_id - cob.SDO_REQUEST
        return LOWEST_NODE <= node <= HIGHEST_NODE and len(data) == SDO_BYTES and data[0] >> 5 in READING


def send_rule(*, asks: bool, writes: bool) -> SendRule:
    """By the options ``--sdo`` and ``--write``."""
    if writes:
        return SendRule.ALL
    return SendRule.READS if asks else SendRule.NOTHING
