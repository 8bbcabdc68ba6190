"""SDO server: one channel of 1200h to 127Fh with its CAN-IDs (CiA 301, 7.2.4, 7.5.2.33)."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from canfb.cia301 import cob
from canfb.cia301.codes import AbortCode, SdoAbort
from canfb.cia301.frame import Frame
from canfb.device.core import NEVER, Core, Pending, Timed
from canfb.device.od.dictionary import Dictionary, Entry
from canfb.device.sdo.transfer import (
    ABORT,
    ABORT_COMMAND,
    BLOCK_DOWNLOAD,
    BLOCK_UPLOAD,
    CRC_SUPPORTED,
    INITIATE_DOWNLOAD,
    INITIATE_UPLOAD,
    BlockDownload,
    BlockUpload,
    SegmentedDownload,
    SegmentedUpload,
    Transfer,
)

TIMEOUT_S = 1.0  # How long a client may be silent within a transfer, seconds.
FIRST_INDEX = 0x1200
LAST_INDEX = 0x127F

_FRAME_LENGTH = 8
_DYNAMIC = 1 << 30


class SdoServer(Timed):
    """One channel, with the COB-IDs of `index`; it exists while both are valid, the first one always.

    Serves one client at a time. A request that is not 8 bytes long is ignored; a new one within a transfer
    ends the old transfer.
    """

    def __init__(self, core: Core, index: int) -> None:
        self._core = core
        self._index = index
        self._request = core.dictionary.assumed(index, 1, cob.NOT_VALID)
        self._response = core.dictionary.assumed(index, 2, cob.NOT_VALID)
        self._answer_id = cob.SDO_RESPONSE + core.node_id
        self._begin: dict[int, Callable[[bytes], Transfer | None]] = {
            INITIATE_DOWNLOAD: self._download,
            INITIATE_UPLOAD: self._upload,
            BLOCK_UPLOAD: self._block_upload,
            BLOCK_DOWNLOAD: self._block_download,
        }
        for entry in (self._request, self._response):
            entry.on_check = partial(_check_cob_id, entry)
            entry.on_written = self._cob_id_written
        self.configure()

    @property
    def request_id(self) -> int | None:
        if self._index == FIRST_INDEX:
            return cob.SDO_REQUEST + self._core.node_id
        if not (cob.is_valid(self._request.value) and cob.is_valid(self._response.value)):
            return None
        return int(self._request.value & cob.CAN_ID)

    @property
    def response_id(self) -> int | None:
        return None if self.request_id is None else self._answer_id

    def configure(self) -> None:
        self.drop()
        if self._index != FIRST_INDEX and self.request_id is not None:  # else keep that of the last answer
            self._answer_id = self._response.value & cob.CAN_ID

    def _cob_id_written(self) -> None:
        self.configure()
        self._core.reactions.routes_changed()

    def drop(self) -> None:
        self._transfer: Transfer | None = None
        self._pending: Pending | None = None
        self.deadline = NEVER

    def handle(self, data: bytes, now: float) -> None:
        if len(data) != _FRAME_LENGTH:
            self._core.counters.malformed_frames += 1
            return
        self._pending = None
        self._core.pending = None
        transfer, self._transfer = self._transfer, None
        # Index and sub-index of the running call.
        self._multiplexer = data[1:4] if transfer is None else transfer.multiplexer
        try:
            if transfer is not None and transfer.accepts(data[0]):
                if transfer.target is not None:  # writing may have been forbidden since the transfer began
                    self._core.application.check_write(transfer.target)
                if transfer.handle(data):
                    self._transfer = transfer
            elif data[0] >> 5 != ABORT:
                begin = self._begin.get(data[0] >> 5)
                if begin is None:
                    raise SdoAbort(AbortCode.COMMAND)
                self._multiplexer = data[1:4]
                self._transfer = begin(data)
        except SdoAbort as abort:
            self._abort(self._multiplexer, abort.code)
        self._schedule(now)

    def tick(self, now: float) -> None:
        transfer = self._transfer
        assert transfer is not None  # without one the deadline is NEVER
        if transfer.pause < NEVER:
            transfer.proceed()
        else:
            self._transfer = None
            self._abort(transfer.multiplexer, AbortCode.TIMEOUT)
        self._schedule(now)

    def _schedule(self, now: float) -> None:
        transfer = self._transfer
        self.deadline = NEVER if transfer is None else now + min(transfer.pause, self._core.sdo_timeout_s)

    def _reply(self, payload: bytes) -> None:
        pending = self._core.pending
        if pending is None:
            self._core.emit(Frame(self._answer_id, payload.ljust(_FRAME_LENGTH, b"\x00")))
        else:
            self._core.pending, self._pending = None, pending
            pending.on_end = partial(self._written, pending, self._multiplexer, payload)

    def _written(self, pending: Pending, multiplexer: bytes, payload: bytes, code: AbortCode | None) -> None:
        if pending is not self._pending:  # a later request replaced it
            return
        self._pending = None
        if code is None:
            self._reply(payload)
        else:
            self._abort(multiplexer, code)

    def _abort(self, multiplexer: bytes, code: AbortCode) -> None:
        self._core.counters.sdo_aborts += 1
        self._reply(bytes([ABORT_COMMAND]) + multiplexer + code.to_bytes(4, "little"))

    def _entry(self, data: bytes) -> Entry:
        return self._core.dictionary.lookup(data[1] | data[2] << 8, data[3])

    def _writable(self, data: bytes) -> Entry:
        entry = self._entry(data)
        entry.check_writable()
        self._core.application.check_write(entry)
        return entry

    def _download(self, data: bytes) -> Transfer | None:
        entry = self._writable(data)
        command, multiplexer = data[0], data[1:4]
        if command & 0x02:
            # If the client gives no size, the size of the entry counts.
            size = 4 - (command >> 2 & 0x03) if command & 0x01 else min(entry.byte_length or 4, 4)
            entry.download(data[4 : 4 + size])
            self._reply(b"\x60" + multiplexer)
            return None
        announced = int.from_bytes(data[4:8], "little") if command & 0x01 else None
        return SegmentedDownload(multiplexer, entry, announced, self._reply)

    def _upload(self, data: bytes) -> Transfer | None:
        return self._answer_upload(data[1:4], self._entry(data).upload())

    def _answer_upload(self, multiplexer: bytes, content: bytes) -> Transfer | None:
        if 1 <= len(content) <= 4:
            self._reply(bytes([0x43 | (4 - len(content)) << 2]) + multiplexer + content)
            return None
        return SegmentedUpload(multiplexer, content, self._reply)

    def _block_upload(self, data: bytes) -> Transfer | None:
        command, block_size, switch_at = data[0], data[4], data[5]
        if command & 0x03:
            raise SdoAbort(AbortCode.COMMAND)
        content = self._entry(data).upload()
        if switch_at and len(content) <= switch_at:  # the protocol switch threshold, 0 for never
            return self._answer_upload(data[1:4], content)
        with_crc = bool(command & CRC_SUPPORTED)
        return BlockUpload(data[1:4], content, block_size, with_crc=with_crc, reply=self._reply)

    def _block_download(self, data: bytes) -> Transfer | None:
        command = data[0]
        if command & 0x01:
            raise SdoAbort(AbortCode.COMMAND)
        entry = self._writable(data)
        announced = int.from_bytes(data[4:8], "little") if command & 0x02 else None
        with_crc = bool(command & CRC_SUPPORTED)
        return BlockDownload(data[1:4], entry, announced, with_crc=with_crc, reply=self._reply)


def _check_cob_id(entry: Entry, value: int) -> None:
    cob.check(value, entry.value, reserved=_DYNAMIC)


def channel_indices(dictionary: Dictionary) -> list[int]:
    further = range(FIRST_INDEX + 1, LAST_INDEX + 1)
    return [FIRST_INDEX, *(index for index in further if (index, 1) in dictionary)]
