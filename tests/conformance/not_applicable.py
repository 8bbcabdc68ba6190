"""The cases that do not apply to a device, and why. What is not here is a test.

`absent` are the objects (index, sub-index) whose absence is the reason: as soon as the EDS has one of
them, the case is asked for.
"""

from dataclasses import dataclass

from conformance_kit import INTERFACE, MODULE


@dataclass(frozen=True)
class NotApplicable:
    why: str
    absent: tuple[tuple[int, int], ...] = ()


def _lacking(text: str, cases: str, *absent: int, sub: int = 0) -> dict[str, NotApplicable]:
    reason = NotApplicable(text, tuple((index, sub) for index in absent))
    return dict.fromkeys(cases.split(), reason)


_NO_RPDO = _lacking(
    "no RPDO", "pdo_01 pdo_27 pdo_28 pdo_29 pdo_33 emcy_04 emcy_05 emcy_06 beyond_11 beyond_21", 0x1400, sub=1
)

NOT_APPLICABLE: dict[str, dict[str, NotApplicable]] = {
    MODULE: {},
    INTERFACE: {
        "sdo_04": NotApplicable("no write-only entry"),
        "sdo_11": NotApplicable("no entry with a minimum above 0"),
        "od_04": NotApplicable("no write-only entry"),
        "pdo_31": NotApplicable("no mappable object that is only written"),
        **_NO_RPDO,
        **_lacking("no heartbeat consumer: no 1016h", "hb_04 hb_05 hb_06 hb_07", 0x1016, sub=1),
        **_lacking("no second SDO server: no 1201h", "beyond_09", 0x1201, sub=1),
        **_lacking("no synchronous window: no 1007h", "beyond_18", 0x1007),
        "beyond_04": NotApplicable("no writable entry of more than one segment"),
    },
}
