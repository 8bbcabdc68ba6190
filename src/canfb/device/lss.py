"""LSS slave: node-ID and bit rate over the bus (CiA 305).

A new node-ID takes effect with the next reset of the communication, a first one at once. LSS answers in
every NMT state, also without a node-ID (255).
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from enum import IntEnum

from canfb.cia301.codes import SdoAbort
from canfb.cia301.frame import Frame
from canfb.device.core import Core
from canfb.device.storage.kept import ParameterGroup, Record
from canfb.device.storage.storage import Storage

REQUEST_ID, RESPONSE_ID = 0x7E5, 0x7E4
UNCONFIGURED = 255  # The node-ID of a device that has none yet.

# The standard table of bit timings; 5 is reserved.
BIT_RATES_KBIT_S = {0: 1000, 1: 800, 2: 500, 3: 250, 4: 125, 6: 50, 7: 20, 8: 10}

SELECT = range(0x40, 0x44)  # Switch state selective: one frame for each part of the address.
# Identify remote slave: vendor-ID, product code, lowest and highest revision, and serial number.
IDENTIFY = range(0x46, 0x4C)
IDENTIFY_NON_CONFIGURED, FASTSCAN = 0x4C, 0x51
SELECTED, IDENTIFIED, NON_CONFIGURED = 0x44, 0x4F, 0x50  # Answers to SELECT, IDENTIFY, and both others.

_CONFIRM = 128  # The bit number of a fastscan that asks whether any device has no node-ID.
_PARTS = range(4)
_LENGTH = 8
_NODE_ID_RECORD, _BIT_RATE_RECORD = (0, 1), (0, 2)
_NO_BIT_RATE = 0xFF


class LssState(IntEnum):
    """The state, by its value in "switch state global"."""

    WAITING = 0
    CONFIGURATION = 1


class LssCommand(IntEnum):
    """Command specifiers of all services but selection and identification."""

    SWITCH_STATE_GLOBAL = 0x04
    CONFIGURE_NODE_ID = 0x11
    CONFIGURE_BIT_TIMING = 0x13
    ACTIVATE_BIT_TIMING = 0x15
    STORE_CONFIGURATION = 0x17
    INQUIRE_IDENTITY = 0x5A  # 5Ah to 5Dh: vendor-ID, product code, revision number, serial number.
    INQUIRE_NODE_ID = 0x5E


class Error(IntEnum):
    """Error code in the answer of a service."""

    NONE = 0
    NOT_POSSIBLE = 1
    STORE_FAILED = 2


def is_node_id(value: int) -> bool:
    return 1 <= value <= 127 or value == UNCONFIGURED


def _collected(parts: list[int], part: int, number: int) -> list[int]:
    if part == 0:
        return [number]
    return [*parts, number] if len(parts) == part else []


class LssSlave:
    """Answers the LSS master, in every NMT state.

    `pending_node_id` takes effect with the next reset of the communication; LSS stores it.
    `bit_rates_kbit_s` are the bit rates that the bus supports.
    """

    def __init__(self, core: Core, storage: Storage, bit_rates_kbit_s: Collection[int]) -> None:
        self.pending_node_id = self._own_node_id = core.node_id
        self.bit_rate_kbit_s: int | None = None  # The configured or stored bit rate; None: neither.
        self._core = core
        self._storage = storage
        self._bit_rates_kbit_s = frozenset(bit_rates_kbit_s)
        self._identity = [core.dictionary.assumed(0x1018, part + 1) for part in _PARTS]
        self._services: dict[int, Callable[[bytes], None]] = {
            LssCommand.CONFIGURE_NODE_ID: self._configure_node_id,
            LssCommand.CONFIGURE_BIT_TIMING: self._configure_bit_timing,
            LssCommand.ACTIVATE_BIT_TIMING: self._activate_bit_timing,
            LssCommand.STORE_CONFIGURATION: self._store,
        }
        self.reset()

    @property
    def address(self) -> list[int]:
        return [int(entry.value) for entry in self._identity]

    def power_on(self) -> None:
        self.pending_node_id, self.bit_rate_kbit_s = self._own_node_id, None
        records = self._storage.records(ParameterGroup.LSS)
        if records is None:
            return
        values = {(record.index, record.subindex): record.data for record in records}
        node_id = int.from_bytes(values.get(_NODE_ID_RECORD, b""), "little")
        timing = int.from_bytes(values.get(_BIT_RATE_RECORD, b""), "little")
        if not is_node_id(node_id):
            self._storage.refuse(ParameterGroup.LSS, f"{node_id} is not a node-ID")
            return
        self.pending_node_id = node_id
        self.bit_rate_kbit_s = BIT_RATES_KBIT_S.get(timing)

    def reset(self) -> None:
        self.state = LssState.WAITING
        self._selection: list[int] = []
        self._range: list[int] = []
        self._scanned = 0  # the part of the address that the fastscan asks for next

    def handle(self, data: bytes, now: float) -> None:
        configuring = self.state is LssState.CONFIGURATION
        if len(data) != _LENGTH:
            self._core.counters.malformed_frames += 1
        elif data[0] == LssCommand.SWITCH_STATE_GLOBAL:
            self._switch_state(data[1], now)
        elif data[0] in self._services:
            if configuring:
                self._change(data)
        elif LssCommand.INQUIRE_IDENTITY <= data[0] <= LssCommand.INQUIRE_NODE_ID:
            if configuring:
                inquired = [*self.address, self._core.node_id][data[0] - LssCommand.INQUIRE_IDENTITY]
                self._answer(data[0], *inquired.to_bytes(4, "little"))
        else:
            self._identify(data[0], int.from_bytes(data[1:5], "little"), data)

    def _change(self, data: bytes) -> None:
        try:
            self._core.application.check_write(None)
        except SdoAbort:
            if data[0] != LssCommand.ACTIVATE_BIT_TIMING:  # which has no answer
                self._answer(data[0], Error.NOT_POSSIBLE)
        else:
            self._services[data[0]](data)

    def _switch_state(self, mode: int, now: float) -> None:
        if mode == LssState.CONFIGURATION:
            self.state = LssState.CONFIGURATION
        elif mode == LssState.WAITING:
            self.state = LssState.WAITING
            self._core.reactions.lss_left(now)

    def _identify(self, command: int, number: int, data: bytes) -> None:
        unconfigured = self._core.node_id == self.pending_node_id == UNCONFIGURED
        waiting = self.state is LssState.WAITING
        if command in SELECT and waiting:
            self._selection = _collected(self._selection, command - SELECT.start, number)
            if self._selection == self.address:
                self._answer(SELECTED)
                self.state = LssState.CONFIGURATION
        elif command in IDENTIFY:
            self._range = _collected(self._range, command - IDENTIFY.start, number)
            if self._is_in_range():
                self._answer(IDENTIFIED)
        elif command == IDENTIFY_NON_CONFIGURED and unconfigured:
            self._answer(NON_CONFIGURED)
        elif command == FASTSCAN and unconfigured and waiting:
            self._fastscan(number, *data[5:8])

    def _is_in_range(self) -> bool:
        if len(self._range) < len(IDENTIFY):
            return False
        vendor, product, low, high, serial_low, serial_high = self._range
        own_vendor, own_product, revision, serial = self.address
        same = (vendor, product) == (own_vendor, own_product)
        return same and low <= revision <= high and serial_low <= serial <= serial_high

    def _fastscan(self, number: int, bit: int, part: int, following: int) -> None:
        if bit == _CONFIRM:
            self._scanned = 0
            self._answer(IDENTIFIED)
        elif (
            bit < 32
            and part == self._scanned
            and following in _PARTS
            and not (number ^ self.address[part]) >> bit
        ):
            self._scanned = following
            self._answer(IDENTIFIED)
            if bit == 0 and following < part:
                self.state = LssState.CONFIGURATION

    def _answer(self, *data: int) -> None:
        self._core.emit(Frame(RESPONSE_ID, bytes(data).ljust(_LENGTH, b"\x00")))

    def _configure_node_id(self, data: bytes) -> None:
        good = is_node_id(data[1])
        if good:
            self.pending_node_id = data[1]
        self._answer(data[0], Error.NONE if good else Error.NOT_POSSIBLE)

    def _configure_bit_timing(self, data: bytes) -> None:
        table, index = data[1:3]
        kbit_s = BIT_RATES_KBIT_S.get(index)
        good = table == 0 and kbit_s in self._bit_rates_kbit_s
        if good:
            self.bit_rate_kbit_s = kbit_s
        self._answer(data[0], Error.NONE if good else Error.NOT_POSSIBLE)

    def _activate_bit_timing(self, data: bytes) -> None:
        if self.bit_rate_kbit_s is not None and self.bit_rate_kbit_s in self._bit_rates_kbit_s:
            delay_s = int.from_bytes(data[1:3], "little") / 1000
            self._core.reactions.bit_rate_activated(self.bit_rate_kbit_s, delay_s)

    def _store(self, data: bytes) -> None:
        rates = {rate: index for index, rate in BIT_RATES_KBIT_S.items()}
        timing = rates.get(self.bit_rate_kbit_s or 0, _NO_BIT_RATE)
        records = [
            Record(*_NODE_ID_RECORD, False, bytes([self.pending_node_id])),
            Record(*_BIT_RATE_RECORD, False, bytes([timing])),
        ]

        def done(error: OSError | None) -> None:
            self._answer(data[0], Error.NONE if error is None else Error.STORE_FAILED)

        if self._storage.is_there:
            self._storage.save_records(ParameterGroup.LSS, records, done)
        else:
            self._answer(data[0], Error.NOT_POSSIBLE)
