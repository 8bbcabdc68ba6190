"""The cases that do not apply to a device, and why. What is not here is a test.

`absent` are the objects (index, sub-index) whose absence is the reason: as soon as the EDS has one of
them, the case is asked for.
"""

from __future__ import annotations

from dataclasses import dataclass

from conformance_kit import INTERFACE, MODULE


@dataclass(frozen=True)
class NotApplicable:
    """Why a case does not apply."""

    why: str
    absent: tuple[tuple[int, int], ...] = ()


def _lacking(text: str, cases: str, *absent: int, sub: int = 0) -> dict[str, NotApplicable]:
    reason = NotApplicable(text, tuple((index, sub) for index in absent))
    return dict.fromkeys(cases.split(), reason)


_NO_GUARDING = "no guarding: 100Ch and 100Dh are not there"
_GUARDING = (
    "sdo_14 sdo_20 sdo_24 guard_01 guard_02 guard_03 guard_04 guard_05 guard_06 "
    "hvg_02 hvg_03 hvg_04 hvg_05 hvg_06 hvg_07"
)
_NO_STORAGE = "no 1010h, so nothing is stored"
_STORAGE = "sync_08 sync_10 other_01 other_02 other_05 other_06"

_WO = "no write-only entry"
_LOW = "no entry with a minimum above 0"

NOT_APPLICABLE: dict[str, dict[str, NotApplicable]] = {
    MODULE: {
        **_lacking(_NO_GUARDING, _GUARDING, 0x100C),
        **_lacking(_NO_STORAGE, _STORAGE, 0x1010),
    },
    INTERFACE: {
        "sdo_04": NotApplicable(_WO),
        "sdo_11": NotApplicable(_LOW),
        **_lacking(_NO_GUARDING, _GUARDING, 0x100C),
        **_lacking(_NO_STORAGE, _STORAGE, 0x1010),
    },
}
