"""Another sensor on the same machine, such as the motor encoder of a drive. Its 32-bit increments wrap."""

from __future__ import annotations

from dataclasses import dataclass

from canfb.checks import within

RANGE = 1 << 32  # increments after which a value wraps
U32 = 0xFFFFFFFF
MOST_TOLERANCE_REVOLUTIONS = 0.25
UNIT_INCREMENTS = 1 << 20  # default per revolution


@dataclass(frozen=True, kw_only=True)
class SecondSensor:
    """The other sensor (2014h); ValueError for a bad value.

    increments               of the sensor in ``revolutions``, 1..4294967295 (2014:01)
    revolutions              of the encoder, 1..4294967295 (2014:02); above 1 for a gear
    reversed                 True: the sensor counts down when the encoder counts up (2014:03)
    tolerance_revolutions    largest difference of the two positions by compliance, backlash and age of the
                             value, 0..0.25 revolutions of the encoder (2014:04); 0: not used
    invalidates              True: the position is not valid while they disagree (2014:05)
    """

    increments: int = UNIT_INCREMENTS
    revolutions: int = 1
    reversed: bool = False
    tolerance_revolutions: float = 0.0
    invalidates: bool = False

    def __post_init__(self) -> None:
        within(
            self,
            increments=(1, U32),
            revolutions=(1, U32),
            tolerance_revolutions=(0.0, MOST_TOLERANCE_REVOLUTIONS),
            reversed=bool,
            invalidates=bool,
        )


def step_increments(before: int, value: int) -> int:
    """Difference from one value, unwrapped or not, to another over the wrap, at most half the range."""
    return (value - before + RANGE // 2) % RANGE - RANGE // 2
