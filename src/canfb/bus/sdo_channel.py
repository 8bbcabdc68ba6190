"""The SDO client of a tool that shares the channel of a node with other clients: all receive its answers
(CiA 301, 7.2.4.1).

Programs of one computer take turns by a locked file; answers to another master are ignored.
"""

from __future__ import annotations

import contextlib
import os
import queue
import sys
import tempfile
import time
import zlib
from collections.abc import Callable, Iterator

import canopen
from canopen.sdo.client import SdoClient
from canopen.sdo.exceptions import SdoAbortedError, SdoCommunicationError

from canfb.cia301 import cob
from canfb.errors import BusError

POLL_S = 0.001
# The longest transfer, a recording of 64 KiB in segments at 125 kbit/s, takes about 20 s.
LONGEST_TURN_S = 30.0


@contextlib.contextmanager
def sdo_turn(bus: str, node_id: int, longest_s: float = LONGEST_TURN_S) -> Iterator[None]:
    """Lock the SDO channel of a node on ``bus`` (its ``channel_info``) among programs of this computer.

    BusError after ``longest_s``. If the file cannot be created, no program waits.
    """
    name = f"canfb-sdo-{zlib.crc32(bus.encode(errors='backslashreplace')):08x}-{node_id}"
    file = _opened(os.path.join(tempfile.gettempdir(), name))
    try:
        end = time.monotonic() + longest_s
        while file is not None:
            with contextlib.suppress(OSError):
                lock_file(file)
                break
            if time.monotonic() >= end:
                raise BusError(
                    f"another canfb program on this computer uses the SDO channel of node {node_id} for more "
                    f"than {longest_s:g} s: end it"
                )
            time.sleep(POLL_S)
        yield
    finally:
        if file is not None:
            os.close(file)


def _opened(path: str) -> int | None:
    wanted = os.O_RDWR if sys.platform == "win32" else os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK
    for flags in (wanted, wanted | os.O_CREAT | os.O_EXCL, wanted):
        with contextlib.suppress(OSError):
            return os.open(path, flags, 0o644)
    return None


def lock_file(file: int) -> None:
    if sys.platform == "win32":
        import msvcrt

        msvcrt.locking(file, msvcrt.LK_NBLCK, 1)
    else:
        import fcntl

        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)


ABORT = 0x80
# The command of the response (scs) for each command of a request (ccs), and whether it contains index and
# sub-index (CiA 301, 7.2.4.3). Block transfers contain them only at the beginning, with subcommand 0.
_ANSWERS = {0: (1, False), 1: (3, True), 2: (2, True), 3: (0, False), 5: (6, True), 6: (5, True)}


class SharedClient(SdoClient):
    """canopen's client, which ignores answers to other masters, and sets ``disturbed`` then.

    ``turn`` locks the channel for one transfer.
    """

    def __init__(
        self,
        network: canopen.Network,
        node_id: int,
        answer_within_s: float,
        turn: Callable[[], contextlib.AbstractContextManager[None]] = contextlib.nullcontext,
    ) -> None:
        super().__init__(cob.SDO_REQUEST + node_id, cob.SDO_RESPONSE + node_id, canopen.ObjectDictionary())  # type: ignore[no-untyped-call]
        self.RESPONSE_TIMEOUT = answer_within_s
        self.network = network
        self.turn = turn
        self.disturbed = False
        self._place = bytes(3)
        self._send: Callable[[bytes], None] = self.send_request
        network.subscribe(self.tx_cobid, self.on_response)

    def frame(self, within_s: float) -> bytes:
        return bytes(self.responses.get(timeout=max(0.0, within_s)))

    def now(self) -> float:
        return time.monotonic()

    def read_response(self, fits: Callable[[bytes], bool] = lambda data: True) -> bytes:
        end = self.now() + self.RESPONSE_TIMEOUT
        said = "No SDO response received"
        while True:
            try:
                data = (self.frame(end - self.now()) + bytes(8))[:8]
            except queue.Empty:
                raise SdoCommunicationError(said) from None
            if data[0] != ABORT and fits(data):
                return data
            if data[0] == ABORT and data[1:4] in (self._place, bytes(3)):
                raise SdoAbortedError(int.from_bytes(data[4:], "little"))
            self.disturbed = True
            said = (
                f"only answers to others are received (the last: {data.hex()}): another master uses this node"
            )

    def request_response(self, sdo_request: bytes) -> bytes:
        command, place = sdo_request[0], bytes(sdo_request[1:4])
        expected, names = _ANSWERS[command >> 5]
        begins = names and (command >> 5 < 5 or not command & 0x01)
        if begins:
            self._place = place
        elif not self.responses.empty():
            self.disturbed = True
        self.responses = queue.Queue()
        self._send(sdo_request)
        try:
            return self.read_response(
                lambda data: data[0] >> 5 == expected and (not begins or data[1:4] == place)
            )
        except SdoCommunicationError:
            self.abort(0x05040000)
            raise

    def abort(self, abort_code: int = 0x08000000) -> None:
        self._send(bytes((ABORT,)) + self._place + abort_code.to_bytes(4, "little"))
