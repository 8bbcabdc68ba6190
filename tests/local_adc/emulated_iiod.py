"""An IIOD network server with an emulated ADC, for the real libiio, and what tests with it need.

The text protocol of libiio 0.x: a connection gives commands, one a line. The answer to a command is a
number, a line of its own: 0, a length, or the negative errno. `READBUF` answers with the length, the mask of
the channels and the data.
"""

import contextlib
import errno
import queue
import re
import socket
import socketserver
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from xml.sax.saxutils import quoteattr

import numpy as np

from canfb.hosting.captured_source import REOPEN_S, CapturedSource
from canfb.signal.sample import Sample
from canfb.simulation.encoder import Encoder, Motion, Ramp
from canfb.simulation.scenario import SimulationConfig
from canfb.sources.iio_source import IioSourceConfig
from canfb.sources.protocol import Surroundings

FORMAT = re.compile(r"(le|be):([sSuU])(\d+)/(\d+)(?:X(\d+))?>>(\d+)")
TIMESTAMP = "timestamp"


@dataclass
class Channel:
    """A channel with its place in a scan and its format, as in scan_elements/in_voltage0_type."""

    id: str
    index: int
    format: str
    output: bool = False

    def pack(self, value: int) -> bytes:
        match = FORMAT.fullmatch(self.format)
        assert match is not None
        order, _, bits, storage, repeat, shift = match.groups()
        word = (value & (1 << int(bits)) - 1) << int(shift)
        # What is beside the bits of a number may be anything.
        word |= (1 << int(shift)) - 1
        if int(bits) + int(shift) < int(storage):
            word |= 1 << int(storage) - 1
        data = word.to_bytes(int(storage) // 8, "little" if order == "le" else "big")
        return data * int(repeat or 1)


def voltage(number: int, format: str = "le:u12/16>>0") -> Channel:
    return Channel(f"voltage{number}", number, format)


def time_stamp(index: int) -> Channel:
    return Channel(TIMESTAMP, index, "le:s64/64>>0")


@dataclass
class EmulatedAdc:
    """What the context holds: an ADC with its triggers, and what was done to it."""

    name: str = "ads7950"
    channels: list[Channel] = field(
        default_factory=lambda: [voltage(0), voltage(1), voltage(2), time_stamp(3)]
    )
    attributes: dict[str, str] = field(
        default_factory=lambda: {"sampling_frequency": "1000", "current_timestamp_clock": "realtime"}
    )
    triggers: dict[str, dict[str, str]] = field(
        default_factory=lambda: {
            "sysfstrig7": {"name": "sysfstrig7", "trigger_now": ""},
            "tick": {"name": "tick", "sampling_frequency": "100"},
        }
    )
    trigger: str | None = None
    on_fire: Callable[[], None] | None = None
    open_error: int = 0
    fire_error: int = 0

    def xml(self) -> str:
        devices = [self._device("iio:device0", self.name, self._channels(), self.attributes)]
        devices += [
            self._device(f"trigger{n}", name, "", attributes)
            for n, (name, attributes) in enumerate(self.triggers.items())
        ]
        return (
            f'<?xml version="1.0" encoding="utf-8"?>{DOCUMENT_TYPE}<context name="network" version-major="0" '
            f'version-minor="24" version-git="v0.24" description="emulated">{"".join(devices)}</context>'
        )

    def _channels(self) -> str:
        return "".join(
            f'<channel id="{one.id}" type="{"output" if one.output else "input"}">'
            + (f'<scan-element index="{one.index}" format="{one.format.replace(">", "&gt;")}" />')
            * (one.index >= 0)
            + "</channel>"
            for one in self.channels
        )

    @staticmethod
    def _device(id: str, name: str, inside: str, attributes: dict[str, str]) -> str:
        inside += "".join(f"<attribute name={quoteattr(key)} />" for key in attributes)
        return f"<device id={quoteattr(id)} name={quoteattr(name)}>{inside}</device>"

    def scan(self, values: dict[str, int], mask: int) -> bytes:
        """A scan as the kernel lays it out: every value at a multiple of its length."""
        data, longest = b"", 1
        for number, channel in enumerate(one for one in self.channels if one.index >= 0):
            if mask >> number & 1:
                packed = channel.pack(values[channel.id])
                data += bytes(-len(data) % len(packed)) + packed
                longest = max(longest, len(packed))
        return data + bytes(-len(data) % longest)


# What libiio holds the description against; without it, it complains on standard error.
DOCUMENT_TYPE = (
    "<!DOCTYPE context [<!ELEMENT context (device)*><!ELEMENT device (channel | attribute)*>"
    "<!ELEMENT channel (scan-element?)><!ELEMENT attribute EMPTY><!ELEMENT scan-element EMPTY>"
    "<!ATTLIST context name CDATA #REQUIRED version-major CDATA #REQUIRED version-minor CDATA #REQUIRED "
    "version-git CDATA #REQUIRED description CDATA #IMPLIED>"
    "<!ATTLIST device id CDATA #REQUIRED name CDATA #IMPLIED>"
    "<!ATTLIST channel id CDATA #REQUIRED type (input|output) #REQUIRED>"
    "<!ATTLIST scan-element index CDATA #REQUIRED format CDATA #REQUIRED>"
    "<!ATTLIST attribute name CDATA #REQUIRED>]>"
)


class EmulatedIiod(socketserver.ThreadingTCPServer):
    """Serves an :class:`EmulatedAdc` on 127.0.0.1; scans come from :meth:`deliver`."""

    allow_reuse_address = True
    daemon_threads = True

    def __init__(self, adc: EmulatedAdc, port: int = 0) -> None:
        super().__init__(("127.0.0.1", port), _Connection)
        self.adc = adc
        self.commands: list[str] = []
        self.opened = threading.Event()
        self.captures: list[queue.Queue[dict[str, int] | int]] = []
        self._connections: set[socket.socket] = set()
        self._thread = threading.Thread(target=self.serve_forever, kwargs={"poll_interval": 0.01})
        self._thread.start()

    @property
    def port(self) -> int:
        return int(self.server_address[1])

    @property
    def uri(self) -> str:
        return f"ip:127.0.0.1:{self.port}"

    def deliver(self, *scans: dict[str, int] | int) -> None:
        """Put scans, or the errno with which capturing fails, into the buffer of everyone who captures."""
        for capture in self.captures:
            for scan in scans:
                capture.put(scan)

    def cut(self) -> None:
        """Break all connections."""
        for connection in list(self._connections):
            with contextlib.suppress(OSError):
                connection.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        self.shutdown()
        self.cut()
        self.server_close()
        self._thread.join()

    def __exit__(self, *args: object) -> None:
        self.close()

    def process_request(  # type: ignore[override]
        self, request: socket.socket, client_address: object
    ) -> None:
        self._connections.add(request)
        super().process_request(request, client_address)

    def shutdown_request(self, request: socket.socket) -> None:  # type: ignore[override]
        self._connections.discard(request)
        super().shutdown_request(request)

    def handle_error(self, request: object, client_address: object) -> None:
        """A connection that ended is no news."""


class _Connection(socketserver.StreamRequestHandler):
    server: EmulatedIiod
    disable_nagle_algorithm = True

    def handle(self) -> None:
        self.mask = 0
        self.timeout_s = 1.0
        self.capture: queue.Queue[dict[str, int] | int] = queue.Queue()
        try:
            while line := self.rfile.readline():
                words = line.decode("ascii").split()
                if not words:
                    continue
                self.server.commands.append(" ".join(words))
                if words[0] == "EXIT":
                    break
                command = getattr(self, f"do_{words[0].lower()}", None)
                if command is None:
                    self.answer(-errno.EINVAL)
                else:
                    command(*words[1:])
        finally:
            self._stop()

    def answer(self, number: int, data: bytes = b"") -> None:
        self.wfile.write(f"{number}\n".encode() + data)

    def text(self, text: str) -> None:
        data = text.encode()
        self.answer(len(data), data + b"\n")

    def _stop(self) -> None:
        if self.capture in self.server.captures:
            self.server.captures.remove(self.capture)
            self.server.opened.clear()

    def do_version(self) -> None:
        self.wfile.write(b"0.24.v0.24\n")

    def do_print(self) -> None:
        self.text(self.server.adc.xml())

    def do_timeout(self, milliseconds: str) -> None:
        self.timeout_s = int(milliseconds) / 1000
        self.answer(0)

    def do_open(self, device: str, samples: str, mask: str, *cyclic: str) -> None:
        if self.server.adc.open_error:
            self.answer(-self.server.adc.open_error)
            return
        self.mask = int(mask, 16)
        self.mask_text = mask
        self.server.captures.append(self.capture)
        self.answer(0)
        self.server.opened.set()

    def do_close(self, device: str) -> None:
        self._stop()
        self.answer(0)

    def do_readbuf(self, device: str, length: str) -> None:
        try:
            scan = self.capture.get(timeout=self.timeout_s)
        except queue.Empty:
            self.answer(-errno.ETIMEDOUT)
            return
        if isinstance(scan, int):
            self.answer(-scan)
            return
        data = self.server.adc.scan(scan, self.mask)
        assert len(data) == int(length), "one scan, and laid out as libiio expects it"
        self.answer(len(data), self.mask_text.encode() + b"\n" + data)

    def _attributes(self, device: str) -> dict[str, str]:
        adc = self.server.adc
        if device.startswith("trigger"):
            return list(adc.triggers.values())[int(device.removeprefix("trigger"))]
        return adc.attributes

    def do_read(self, device: str, attribute: str) -> None:
        self.text(self._attributes(device)[attribute])

    def do_write(self, device: str, attribute: str, length: str) -> None:
        value = self.rfile.read(int(length)).rstrip(b"\0").decode()
        adc = self.server.adc
        if attribute == "trigger_now":
            if adc.fire_error:
                self.answer(-adc.fire_error)
                return
            if adc.on_fire is not None:
                adc.on_fire()
        self._attributes(device)[attribute] = value
        self.answer(int(length))

    def do_set(self, device: str, name: str, value: str) -> None:
        self.answer(0)

    def do_gettrig(self, device: str) -> None:
        if self.server.adc.trigger is None:
            self.answer(-errno.ENODEV)
        else:
            self.text(self.server.adc.trigger)

    def do_settrig(self, device: str, trigger: str = "") -> None:
        number = int(trigger.removeprefix("trigger")) if trigger else -1
        self.server.adc.trigger = list(self.server.adc.triggers)[number] if trigger else None
        self.answer(0)


LIMIT_S = 60.0  # for what takes milliseconds, or a second


def until(happened: Callable[[], bool], what: str) -> None:
    """Wait for what another thread does."""
    end = time.monotonic() + LIMIT_S
    while not happened():
        assert time.monotonic() < end, f"not {what} within {LIMIT_S:g} s"
        time.sleep(0.001)


def iio_source(config: IioSourceConfig, reopen_s: float = REOPEN_S) -> CapturedSource:
    """The source of this configuration; what opens it closes it."""
    with contextlib.ExitStack() as resources:
        captured = partial(CapturedSource, reopen_s=reopen_s)
        source = config.open(Surroundings(12, 2500, SimulationConfig().source, captured, resources))
    assert isinstance(source, CapturedSource)
    return source


def reading(sine: int, cosine: int, time_ns: int = 0) -> dict[str, int]:
    return {"voltage0": sine, "voltage1": cosine, "voltage2": 77, "timestamp": time_ns}


def deliver(server: EmulatedIiod, source: CapturedSource, *scans: dict[str, int]) -> None:
    """Scans that have come before the next SYNC."""
    wanted = source.scans + len(scans)
    server.deliver(*scans)
    until(lambda: source.scans == wanted, "delivered")


class Machine:
    """An encoder on a machine that is scanned at even times; where it was at each scan, in cycles."""

    def __init__(self, scan_s: float, *ramps: Ramp) -> None:
        self.scan_s = scan_s
        self.truth_cycles: list[float] = []
        self._motion, self._encoder = Motion(ramps), Encoder(noise_lsb=0.5)
        self._rng = np.random.default_rng(11)

    def scan(self) -> dict[str, int]:
        time_s = len(self.truth_cycles) * self.scan_s
        self.truth_cycles.append(self._motion.revolutions(time_s) * 2500)
        sine, cosine = self._encoder.sample(self.truth_cycles[-1], self._rng)
        return reading(int(sine) + 2048, int(cosine) + 2048, round(time_s * 1e9))

    def scans_until(self, until_s: float) -> list[dict[str, int]]:
        """Those that are due."""
        found = []
        while len(self.truth_cycles) * self.scan_s <= until_s:
            found.append(self.scan())
        return found


def sample(sine: int, cosine: int, time_100ns: int | None) -> Sample:
    return Sample(sine, cosine, time_100ns=time_100ns)


def fired_by_sync(server: EmulatedIiod) -> str:
    """The source of a configuration: an ADC that samples when its trigger is fired."""
    place = f"uri: 'ip:127.0.0.1:{server.port}', device: ads7950"
    return f"{{kind: iio, {place}, trigger: sysfstrig7, wait_us: 1000000}}"
