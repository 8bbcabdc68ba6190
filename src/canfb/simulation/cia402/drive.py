"""A CiA 402 servo drive as a node: defaults, state machine and faults."""

from __future__ import annotations

import math
from enum import IntEnum

from canfb import objects as od
from canfb.cia301 import cob
from canfb.cia301.codes import ErrorRegister, NmtState
from canfb.cia301.frame import Frame
from canfb.device.core import NEVER, CanIds
from canfb.device.od.dictionary import Dictionary, refuse_if
from canfb.eds_files import eds_path
from canfb.interface.encoder_interface import MachineNode
from canfb.module.cia406.position import U32, saturated
from canfb.module.module_config import ModuleConfig
from canfb.module.parameters import Values, apply_defaults, configured_defaults
from canfb.simulation.cia402.axis import Axis
from canfb.simulation.cia402.feedback_input import FeedbackInput, SyncInterval, Wrong
from canfb.simulation.cia402.plant import DriveConfig, Plant
from canfb.simulation.cia402.state_machine import POWERED, SWITCHED_ON, Command, State, StateMachine, Status

EDS = "drive"
POSITION = (0x60E4, 1)
COAST, QUICK_STOP_RAMP = 0, 2  # 605Eh
ABORT_CONNECTION = {1: Command.FAIL, 2: Command.DISABLE_VOLTAGE, 3: Command.QUICK_STOP}  # 6007h
G_CM2_PER_KG_M2 = 1e7
STOP_TIMEOUT_S = 0.5  # Time for the shaft to come to rest after a ramp; then the power is switched off.


class ServoDrive(MachineNode):
    """A drive, sans-I/O, that turns the motor of ``plant`` by the positions of a feedback ``module``.

    Attach the plant to the bus first. Its configuration and the module determine the defaults, which a reset
    restores.
    """

    def __init__(self, plant: Plant, module: ModuleConfig | None = None, *, autostart: bool = False) -> None:
        config = plant.motor.config
        dictionary = Dictionary.load(eds_path(EDS), config.node_id)
        apply_defaults(dictionary, _defaults(config, module))
        super().__init__(
            dictionary, config.node_id, autostart=autostart, store=None, bit_rates_kbit_s=(), expiry=self
        )
        self.plant = plant
        self.feedback = FeedbackInput(self.dictionary)
        self.axis = Axis(self.dictionary, self.feedback, config.motor_increments, self._show)
        self._machine = StateMachine()
        self._interval = SyncInterval()
        self._watched_from_s = 0.0
        self._stop_by_s = math.inf
        self._rpdo: int | None = None
        entry = self.dictionary.entry
        sync = entry(*od.SYNC_COB_ID)
        plant.sync_cob_id = lambda: sync.value
        self._period, self._cycle, self._dead = entry(0x1006), entry(0x2101, 1), entry(0x2101, 2)
        self._statusword, self._error = entry(0x6041), entry(0x603F)
        self._torque = entry(0x6077)
        self._abort_option, self._fault_option = entry(0x6007), entry(0x605E)
        self._emergency_id, self._sync_timeout = entry(0x2110, 7), entry(0x2110, 8)
        self._emergency_id.on_written = self._life.routes_changed
        self._controlword = entry(0x6040)
        self._controlword.on_written = self._controlled
        self._fault_option.on_check = refuse_if(lambda value: value not in (COAST, QUICK_STOP_RAMP))

    @property
    def power(self) -> State:
        return self._machine.state

    @property
    def error(self) -> int:
        return int(self._error.value)

    def describe(self) -> str:
        node, module = self.node_id, self._emergency_id.value & cob.NODE_ID
        return f"drive: node {node} ({node:02X}h), position from node {module} ({module:02X}h)"

    def summary(self) -> str:
        state = self.power.name.replace("_", " ").capitalize()
        error = f", error {self.error:04X}h" if self.error else ""
        return f"drive: {state}{error}; the shaft is at {self.plant.motor.revolutions:.3f} revolutions"

    @property
    def interval_s(self) -> float:
        """SYNC period, seconds: 1006h, else measured; 0.0 while unknown."""
        return float(self._period.value / 1e6) or self._interval.seconds

    @property
    def until(self) -> float:
        timeout_ms = self._sync_timeout.value
        watched = self.power in SWITCHED_ON or self.power is State.FAULT_REACTION_ACTIVE
        if not timeout_ms or not watched or self.state is not NmtState.OPERATIONAL:
            return NEVER
        return self._watched_from_s + float(timeout_ms / 1000.0)

    def overdue(self, now: float) -> None:
        self._fail(DriveError.SYNC_CONTROLLER)
        self._switch(Command.RAMP_DONE)  # without SYNC there is no ramp either

    def can_ids(self) -> CanIds:
        data, remote = super().can_ids()
        emergency = self._emergency_id.value
        return CanIds(data | {emergency & cob.CAN_ID, cob.ERROR_CONTROL + (emergency & cob.NODE_ID)}, remote)

    def receive(self, frame: Frame, now: float) -> list[Frame]:
        answers = super().receive(frame, now)
        self._overhear(frame)
        return answers + self._sent()

    def _overhear(self, frame: Frame) -> None:
        cob_id = self._emergency_id.value
        if frame.rtr or not cob.is_valid(cob_id) or self.state is NmtState.STOPPED:
            return
        if frame.can_id == cob_id & cob.CAN_ID and len(frame.data) == 8:
            self.feedback.emergency(int.from_bytes(frame.data[:2], "little"))
        elif frame.can_id == cob.ERROR_CONTROL + (cob_id & cob.NODE_ID) and frame.data == b"\x00":
            self.feedback.boot_up()
        else:
            return
        self._supervise()

    def sync_received(self, counter: int | None, now: float) -> None:
        self._interval.event(self.received_s)
        self._watched_from_s = now
        self.feedback.sync(self.received_s)
        plant = self.plant
        self.axis.measure_motor(plant.motor.revolutions_before(plant.ahead_s(self.received_s)))
        self._supervise()
        period_s = self.interval_s
        self._cycle.value = period_s
        if period_s > 0.0 and self.power in POWERED:
            self.axis.advance(period_s)
            self._end_stop()
        self._show()

    def rpdo_received(self, number: int, now: float) -> None:
        if number != self._rpdo:
            return
        period_s = self.interval_s
        used = self.feedback.take(
            self.axis.scaling.largest_speed, period_s, supervised=self.power in SWITCHED_ON | POWERED
        )
        self._supervise()
        if used:
            self.axis.measure()
        if used and period_s > 0.0 and self.power in POWERED:
            self.plant.drive(self.axis.control(period_s), True, self.received_s)
            since_sync_s = self.received_s - (self._interval.last_s or self.received_s)
            self._dead.value = saturated(since_sync_s * 1e6, 32)
            if self.axis.follows_badly(self.received_s):
                self._fail(DriveError.FOLLOWING_ERROR)
        self._show()

    def _supervise(self) -> None:
        wrong = self.feedback.wrong
        if not wrong:
            return
        if self.power in SWITCHED_ON:
            position = wrong & (Wrong.RANGE | Wrong.STEP)
            self._fail(DriveError.POSITION_SENSOR if position else DriveError.INCREMENTAL_SENSOR)
        elif self.power is State.FAULT_REACTION_ACTIVE:  # a ramp requires a position
            self._switch(Command.RAMP_DONE)

    def _fail(self, error: DriveError) -> None:
        if not self._machine.go(Command.FAIL):
            return
        self._error.value = int(error)
        if error is not DriveError.HEARTBEAT:  # the node has reported that one itself
            self._announce(error)
        self._show()
        if error is DriveError.FOLLOWING_ERROR and self._fault_option.value == QUICK_STOP_RAMP:
            self.axis.ramp_down(from_actual=True)
            self._stop_by_s = math.inf
        else:
            self._switch(Command.RAMP_DONE)

    def _announce(self, error: DriveError) -> None:
        detail = int(self.feedback.wrong).to_bytes(2, "little") + self.feedback.status.to_bytes(2, "little")
        register = ErrorRegister.DEVICE_PROFILE
        if error in (DriveError.SYNC_CONTROLLER, DriveError.COMMUNICATION, DriveError.HEARTBEAT):
            register |= ErrorRegister.COMMUNICATION
        self.emergency(error, register, detail)

    def _end_stop(self) -> None:
        if self.power is State.OPERATION_ENABLED or not self.axis.ramp_is_over:
            return
        self._stop_by_s = min(self._stop_by_s, self.received_s + STOP_TIMEOUT_S)
        if self.axis.stands_still or self.received_s >= self._stop_by_s:
            self._switch(Command.RAMP_DONE)

    def _controlled(self) -> None:
        command = self._machine.command(self._controlword.value)
        if command is not Command.FAULT_RESET or not self.feedback.wrong:
            self._switch(command)
        self._supervise()
        self._show()

    def _switch(self, command: Command) -> None:
        before = self.power
        if not self._machine.go(command):
            return
        after = self.power
        if before is State.FAULT:
            for error in DriveError:
                self.clear_emergency(error)
            self._error.value = int(DriveError.NONE)
        if after in SWITCHED_ON and before not in SWITCHED_ON:
            self._watched_from_s = self.now
        if after is State.QUICK_STOP_ACTIVE:
            self._stop_by_s = math.inf
            self.axis.ramp_down()
        elif after is State.OPERATION_ENABLED:
            self.axis.start()
            self.plant.drive(0.0, True, self.received_s)
        else:
            self._power_off()
        self._show()

    def _power_off(self) -> None:
        self.plant.drive(0.0, False, self.received_s)
        self.axis.power_off()

    def communication_failed(self, now: float) -> None:
        self._abort_connection(DriveError.HEARTBEAT)

    def state_changed(self, old: NmtState, new: NmtState, now: float, why: str) -> None:
        """Any change invalidates the feedback; leaving OPERATIONAL switches the power off."""
        super().state_changed(old, new, now, why)
        self.feedback.lose()
        if old is NmtState.OPERATIONAL:
            self._abort_connection(DriveError.COMMUNICATION)
            if self.power in POWERED:  # no SYNC and no position: the motor must have no torque
                self._switch(Command.RAMP_DONE)  # the only command that a fault reaction accepts
                self._switch(Command.DISABLE_VOLTAGE)
        self._show()

    def _abort_connection(self, error: DriveError) -> None:
        if self.power not in SWITCHED_ON:
            return
        command = ABORT_CONNECTION.get(self._abort_option.value, Command.NONE)
        if command is Command.FAIL:
            self._fail(error)
        else:
            self._switch(command)

    def reset_done(self, communication_only: bool, now: float) -> None:
        """Power-on of the drive; after a reset of the communication report a fault again."""
        self._interval = SyncInterval()
        self.feedback.reset()
        if not communication_only:
            self._machine = StateMachine(State.SWITCH_ON_DISABLED)
            self._error.value = int(DriveError.NONE)
            self._power_off()
        elif self.power is State.FAULT:
            self._announce(DriveError(self.error))

    def configuration_changed(self) -> None:
        self._rpdo = self.rpdo_with(POSITION)

    def _show(self) -> None:
        before = self._statusword.value
        mode_changed = self.axis.show_mode()
        word = self.power.value | Status.VOLTAGE_ENABLED
        if self.state is NmtState.OPERATIONAL:
            word |= Status.REMOTE
        word |= self.axis.status(self.power is State.OPERATION_ENABLED)
        self._statusword.value = int(word)
        self._torque.value = self.axis.scaling.per_mille(self.plant.motor.torque_nm)
        if mode_changed or before != self._statusword.value:
            for number in range(1, 5):
                self.trigger_tpdo(number, self.now)


class DriveError(IntEnum):
    """Error codes of the drive (603Fh)."""

    NONE = 0x0000
    INCREMENTAL_SENSOR = 0x7305  # the feedback reports that it is not valid, or is missing
    POSITION_SENSOR = 0x7320  # an impossible position
    COMMUNICATION = 0x8100  # NMT has taken the drive out of Operational
    HEARTBEAT = 0x8130
    FOLLOWING_ERROR = 0x8611
    SYNC_CONTROLLER = 0x8700  # no SYNC


def _defaults(config: DriveConfig, module: ModuleConfig | None) -> Values:
    defaults: Values = {
        (0x6076, 0): round(config.rated_torque_nm * 1000),
        (0x2100, 5): max(1, min(U32, round(config.inertia_kg_m2 * G_CM2_PER_KG_M2))),
    }
    if module is not None:
        scale = configured_defaults(module)
        defaults |= {
            (0x1403, 1): cob.TPDO1 + module.node_id,
            (0x1403, 2): 1 if config.synchronous_feedback else 255,
            (0x2110, 5): scale[od.TOTAL_RANGE],  # applies without scaling, too
            (0x2110, 7): cob.EMERGENCY + module.node_id,
            (0x60E6, 1): scale[od.UNITS_PER_REVOLUTION],
        }
    return defaults
