"""The section ``drive`` of a configuration: what ``canfb simulate`` runs beside the encoder interface."""

from __future__ import annotations

from dataclasses import dataclass

from canfb.checks import flag, integer_in, number_in
from canfb.simulation.cia402.motor import MotorConfig


@dataclass(frozen=True, kw_only=True)
class DriveConfig(MotorConfig):
    """A drive on the shaft of the encoder, and its motor.

    node_id                of the drive, 1..127
    start_revolutions      where the shaft stands at the start, -1e6..1e6 revolutions
    motor_increments       of an encoder on the motor in a revolution, 0..4294967295: 6063h is then its
                           position at the SYNC; 0: there is none, and 6063h is that of the feedback
    slip_revolutions       by which the coupling between motor and encoder slips, -1000..1000 revolutions, in
                           half a second; 0: it holds
    slip_at_s              when it begins to, time of the machine, 0..1e9 s
    synchronous_feedback   true: the torque follows at the next SYNC (RPDO4 of type 1); false: at once (255)
    """

    node_id: int = 0x30
    start_revolutions: float = 0.0
    motor_increments: int = 0
    slip_revolutions: float = 0.0
    slip_at_s: float = 0.0
    synchronous_feedback: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        integer_in("node_id", self.node_id, 1, 127)
        number_in("start_revolutions", self.start_revolutions, -1e6, 1e6)
        integer_in("motor_increments", self.motor_increments, 0, 0xFFFFFFFF)
        number_in("slip_revolutions", self.slip_revolutions, -1000.0, 1000.0)
        number_in("slip_at_s", self.slip_at_s, 0.0, 1e9)
        flag("synchronous_feedback", self.synchronous_feedback)
