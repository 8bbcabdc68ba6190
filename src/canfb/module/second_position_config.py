"""``second_position:`` of a module in the configuration: another sensor of the machine, and its PDO."""

from __future__ import annotations

from dataclasses import dataclass

from canfb.checks import integer_in
from canfb.signal.second_position import SecondSensor

LOWEST_COB_ID, HIGHEST_COB_ID = 0x181, 0x57F
MOST_GAP_BYTES = 4  # of a PDO with an INTEGER32
GAPS = ((4, 0x00070020), (2, 0x00060010), (1, 0x00050008))  # dummy objects (CiA 301, 7.4.4), by their bytes
VALUE = 0x20000E20


@dataclass(frozen=True, kw_only=True)
class SecondPositionConfig(SecondSensor):
    """The other sensor, and where its value is on the bus.

    cob_id         of the PDO with the value, 385..1407 (181h..57Fh), for the first free RPDO. None: a
                   master maps 2000:0E
    before_bytes   of that PDO before the value, 0..4
    after_bytes    of that PDO after the value, 0..4; with those before it at most 4
    """

    cob_id: int | None = None
    before_bytes: int = 0
    after_bytes: int = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.cob_id is not None:
            integer_in("cob_id", self.cob_id, LOWEST_COB_ID, HIGHEST_COB_ID)
        integer_in("before_bytes", self.before_bytes, 0, MOST_GAP_BYTES)
        integer_in("after_bytes", self.after_bytes, 0, MOST_GAP_BYTES - self.before_bytes)

    @property
    def mapping(self) -> list[int]:
        """The mapping entries of its RPDO: the value, and dummy objects around it."""
        return [*_gap(self.before_bytes), VALUE, *_gap(self.after_bytes)]


def _gap(size: int) -> list[int]:
    entries = []
    for width, entry in GAPS:
        if size >= width:
            entries.append(entry)
            size -= width
    return entries
