"""How the module and the bus are set up: SYNC counter, sample times, 1006h, receive timestamps."""

from __future__ import annotations

import struct
from dataclasses import dataclass

from canfb import FeedbackModule, Frame, ModuleConfig

NODE, INTERFACE = 32, 16
SYNC_ID, NMT_ID = 0x080, 0x000
ADC_ID, EXTRA_ID, TIMES_ID = 0x180 + INTERFACE, 0x280 + INTERFACE, 0x380 + INTERFACE
TPDO1_ID, EMCY_ID, SDO_TX, SDO_RX = 0x180 + NODE, 0x080 + NODE, 0x580 + NODE, 0x600 + NODE
CYCLES_PER_REVOLUTION = 2500
UNITS_PER_CYCLE = 8192  # 6004h without scaling
RANGE_CYCLES = 209 * CYCLES_PER_REVOLUTION  # where 6004h wraps
TWO_PI = 6.283185307179586
WRITE_REPLY = 0x60


@dataclass(frozen=True)
class Setup:
    """One column of the campaign.

    counter: the SYNC has one; times: the ADC PDO holds the sample time; period: 1006h is written (None:
    in half of the episodes); stamps: frames carry their receive time; servo: two pairs of tracks for
    each SYNC, and the motion of a servo.
    """

    name: str
    counter: bool = False
    times: bool = False
    period: bool | None = None
    stamps: bool = False
    servo: bool = False


SETUPS = tuple(
    Setup(name + ("/rx" if stamps else ""), counter, times, period, stamps)
    for stamps in (False, True)
    for name, counter, times, period in (
        ("plain", False, False, None),
        ("counter", True, False, None),
        ("times", False, True, True),
        ("times-free", False, True, False),
        ("times+counter", True, True, None),
    )
) + tuple(
    Setup("servo" + ("/rx" if stamps else ""), times=True, stamps=stamps, servo=True)
    for stamps in (False, True)
)


def setup_of(name: str) -> Setup:
    """The set-up with this name."""
    return next(one for one in SETUPS if one.name == name)


@dataclass
class Options:
    """What one episode sets in the module, beyond its :class:`Setup`."""

    interval_s: float = 1e-3
    jitter_s: float = 0.0  # 2010:0D
    coast: int | None = None  # 2010:03; None: as delivered
    limit: float | None = None  # 2010:02 in cycles/T^2; None: not known
    margin: int = 0  # 2010:09
    exact: bool = False  # tracks without errors of the cycle, as with a correction table
    overflow: int = 10
    period: bool = False  # write 1006h
    period_factor: float = 1.0  # what 1006h says, relative to the truth
    rpdo_type: int = 255
    tpdo_type: int = 254
    event_timer_ms: int = 0
    predict: int = 0  # 2013:01
    extra: bool = False  # RPDO2 with flags and place of the zero pulse
    coarse: bool = False  # RPDO2 with the coarse track
    stays: bool = False  # 1029h:01 is 1: OPERATIONAL also without a bus
    acceleration: bool = False  # TPDO3 with status and 2011:09


class Bench:
    """One module, reset by NMT between episodes, or made new."""

    def __init__(self) -> None:
        self.module: FeedbackModule | None = None
        self.now = 100.0

    def begin(self, setup: Setup, options: Options, fresh: bool = False) -> FeedbackModule:
        """A module in PRE-OPERATIONAL with this set-up; its time is :attr:`now`."""
        if fresh or self.module is None:
            self.module, self.now = (
                FeedbackModule(ModuleConfig(node_id=NODE, encoder_interface=INTERFACE)),
                100.0,
            )
            self.module.start(self.now)
        else:
            self.now = float(int(self.now) + 2)
            self.module.receive(Frame(NMT_ID, bytes([129, NODE])), self.now)
            self.module.chain.restart()  # a new module knows nothing of the machine of the last episode
        self._configure(self.module, setup, options)
        return self.module

    def _configure(self, module: FeedbackModule, setup: Setup, options: Options) -> None:
        """RuntimeError if the module refuses it."""
        for request in Configuration(setup, options).frames:
            self.now += 1e-4
            frames = module.receive(request, self.now)
            (reply,) = [frame.data for frame in frames if frame.can_id == SDO_TX]
            if reply[0] != WRITE_REPLY:
                raise RuntimeError(f"{request.data.hex()}: {reply.hex()}")


class Configuration:
    """The SDO downloads that put a set-up in force, as ``frames``."""

    def __init__(self, setup: Setup, options: Options) -> None:
        self.frames: list[Frame] = []
        write = self._write
        if setup.counter:
            write(0x1019, 0, "B", options.overflow)
        if options.period:
            write(0x1006, 0, "I", round(options.interval_s * options.period_factor * 1e6))
        if options.jitter_s:
            write(0x2010, 13, "f", options.jitter_s)
        if options.limit is not None:
            per_cycle = TWO_PI / CYCLES_PER_REVOLUTION
            write(0x2010, 2, "f", options.limit * per_cycle / options.interval_s**2)
        if options.coast is not None:
            write(0x2010, 3, "B", options.coast)
        if setup.servo:
            self._be_servo(options)
        elif setup.times:
            self._map(0x1400, 0x1600, ADC_ID, (0x20000110, 0x20000210, 0x20000520), options.rpdo_type)
        elif options.rpdo_type != 255:
            write(0x1400, 2, "B", options.rpdo_type)
        extra = (0x20000310, 0x20000410) * options.coarse + (0x20000608, 0x20000710) * options.extra
        if extra:
            self._map(0x1401, 0x1601, EXTRA_ID, extra, options.rpdo_type)
        if options.tpdo_type != 254:
            write(0x1800, 2, "B", options.tpdo_type)
        if options.predict:
            write(0x2013, 1, "B", options.predict)
        if options.event_timer_ms:
            write(0x6200, 0, "H", options.event_timer_ms)
        if options.stays:
            write(0x1029, 1, "B", 1)
        if options.acceleration:
            self._map(0x1802, 0x1A02, 0x380 + NODE, (0x20110110, 0x20110920), 254)

    def _be_servo(self, options: Options) -> None:
        write = self._write
        write(0x2010, 9, "B", options.margin)
        tracks = (0x20000110, 0x20000210, 0x20000810, 0x20000910)
        self._map(0x1400, 0x1600, ADC_ID, tracks, options.rpdo_type)
        self._map(0x1402, 0x1602, TIMES_ID, (0x20000520,), options.rpdo_type)

    def _map(self, index: int, mapping: int, can_id: int, objects: tuple[int, ...], kind: int) -> None:
        """A PDO with these objects, not valid while it is mapped."""
        write = self._write
        write(index, 1, "I", 0xC0000000 | can_id)
        write(mapping, 0, "B", 0)
        for n, one in enumerate(objects, 1):
            write(mapping, n, "I", one)
        write(mapping, 0, "B", len(objects))
        write(index, 2, "B", kind)
        write(index, 1, "I", 0x40000000 | can_id if index >= 0x1800 else can_id)

    def _write(self, index: int, subindex: int, kind: str, value: float) -> None:
        self.frames.append(sdo_write(index, subindex, kind, value))


def sdo_write(index: int, subindex: int, kind: str, value: float) -> Frame:
    """The request of an expedited SDO download."""
    data = struct.pack("<" + kind, value)
    head = struct.pack("<BHB", 0x23 | (4 - len(data)) << 2, index, subindex)
    return Frame(SDO_RX, head + data.ljust(4, b"\0"))


def sdo_read(index: int, subindex: int) -> Frame:
    """The request of an SDO upload."""
    return Frame(SDO_RX, struct.pack("<BHBI", 0x40, index, subindex, 0))
