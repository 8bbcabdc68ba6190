"""Set-ups of module and bus: SYNC counter, sample times, 1006h, receive time stamps."""

import struct
from dataclasses import dataclass, replace

from canfb import FeedbackModule, Frame

NODE, INTERFACE = 32, 16
SYNC_ID, NMT_ID = 0x080, 0x000
ADC_ID, EXTRA_ID, TIMES_ID = 0x180 + INTERFACE, 0x280 + INTERFACE, 0x380 + INTERFACE
TPDO1_ID, EMCY_ID, SDO_TX, SDO_RX = 0x180 + NODE, 0x080 + NODE, 0x580 + NODE, 0x600 + NODE
CYCLES_PER_REVOLUTION = 2500
UNITS_PER_CYCLE = 8192  # of 6004h without scaling
RANGE_CYCLES = 209 * CYCLES_PER_REVOLUTION  # range after which 6004h wraps
SECOND_INCREMENTS = 1 << 20  # 2014:01, per revolution
TWO_PI = 6.283185307179586
WRITE_REPLY = 0x60
SECOND, THIRD = (0x20000810, 0x20000910), (0x20000A10, 0x20000B10)  # earlier pairs of one SYNC


@dataclass(frozen=True)
class Setup:
    """One column of the campaign.

    counter: SYNC has a counter; times: the ADC PDO contains the sample time; period: 1006h is written (None:
    in half of the episodes); stamps: frames have their receive time; servo: pairs of tracks for each
    SYNC, with the motion of a servo (0: one pair, other motions).
    """

    name: str
    counter: bool = False
    times: bool = False
    period: bool | None = None
    stamps: bool = False
    servo: int = 0

    def fits(self, words: str) -> bool:
        """Whether the set-up has all of these properties, and none marked !; | separates alternatives."""
        return any(
            all(bool(getattr(self, word.lstrip("!"))) != word.startswith("!") for word in part.split())
            for part in words.split("|")
        )


_WITHOUT_RX = (
    Setup("plain"),
    Setup("counter", counter=True),
    Setup("times", times=True, period=True),
    Setup("times-free", times=True, period=False),
    Setup("times+counter", counter=True, times=True),
)
_SERVO = (Setup("servo", times=True, servo=2), Setup("servo-3", times=True, servo=3), Setup("pairs", servo=2))
SETUPS = {
    one.name: one
    for group in (_WITHOUT_RX, _SERVO)
    for stamps in (False, True)
    for one in (replace(one, name=one.name + "/rx" * stamps, stamps=stamps) for one in group)
}


@dataclass
class Options:
    """Settings of the module in one episode, in addition to its :class:`Setup`."""

    interval_s: float = 1e-3
    jitter_s: float = 0.0  # 2010:0D
    answer_s: float = 0.0  # 2010:0E
    coast: int | None = None  # 2010:03; None: default
    limit: float | None = None  # 2010:02 in cycles/T^2; None: not known
    margin: int = 0  # 2010:09
    exact: bool = False  # tracks without errors of the cycle, as with a correction table
    overflow: int = 10
    period: bool = False  # write 1006h
    period_factor: float = 1.0  # 1006h / true period
    rpdo_type: int = 255
    tpdo_type: int = 254
    event_timer_ms: int = 0
    predict: int = 0  # 2013:01
    extra: bool = False  # RPDO2 with flags and place of the zero pulse
    coarse: bool = False  # RPDO2 with the coarse track
    second: float = 0.0  # RPDO2 with a second position: 2014:04, revolutions
    stays: bool = False  # 1029h:01 is 1: OPERATIONAL also without a bus
    follows: bool = False  # earlier samples divide the interval evenly also after a change of the rate
    acceleration: bool = False  # TPDO3 with status and 2011:09


def set_up(module: FeedbackModule, setup: Setup, options: Options, now: float) -> float:
    """Configure and start the module with this set-up; returns the begin of the episode, seconds."""
    for request in configuration(setup, options):
        now += 1e-4
        frames = module.receive(request, now)
        (reply,) = [frame.data for frame in frames if frame.can_id == SDO_TX]
        if reply[0] != WRITE_REPLY:
            raise RuntimeError(f"{request.data.hex()}: {reply.hex()}")
    module.receive(Frame(NMT_ID, bytes([1, NODE])), now + 0.005)
    return now + 0.01


def configuration(setup: Setup, options: Options) -> list[Frame]:
    o = options
    limit = 0.0 if o.limit is None else o.limit * TWO_PI / CYCLES_PER_REVOLUTION / o.interval_s**2
    simple = (
        (setup.counter, 0x1019, 0, "B", o.overflow),
        (o.period, 0x1006, 0, "I", round(o.interval_s * o.period_factor * 1e6)),
        (o.jitter_s, 0x2010, 13, "f", o.jitter_s),
        (o.answer_s, 0x2010, 14, "f", o.answer_s),
        (o.limit is not None, 0x2010, 2, "f", limit),
        (o.coast is not None, 0x2010, 3, "B", o.coast),
        (setup.servo, 0x2010, 9, "B", o.margin),
        (o.rpdo_type != 255 and not setup.times, 0x1400, 2, "B", o.rpdo_type),
        (o.tpdo_type != 254, 0x1800, 2, "B", o.tpdo_type),
        (o.predict, 0x2013, 1, "B", o.predict),
        (o.event_timer_ms, 0x6200, 0, "H", o.event_timer_ms),
        (o.stays, 0x1029, 1, "B", 1),
        (o.second, 0x2014, 4, "f", o.second),
        (o.second, 0x2014, 5, "B", 1),
    )
    frames = [sdo_write(index, sub, kind, value or 0) for is_set, index, sub, kind, value in simple if is_set]
    if setup.times or setup.servo:
        second = SECOND if setup.servo else (0x20000520,)
        frames += _mapping(0x1400, ADC_ID, (0x20000110, 0x20000210, *second), o.rpdo_type)
    if setup.servo and setup.times:
        frames += _mapping(0x1402, TIMES_ID, THIRD * (setup.servo > 2) + (0x20000520,), o.rpdo_type)
    extra = (0x20000310, 0x20000410) * o.coarse + (0x20000608, 0x20000710) * o.extra
    extra += (0x20000E20,) * bool(o.second)
    if extra:
        frames += _mapping(0x1401, EXTRA_ID, extra, o.rpdo_type)
    if o.acceleration:
        frames += _mapping(0x1802, 0x40000380 + NODE, (0x20110110, 0x20110920), 254)
    return frames


def _mapping(index: int, cob_id: int, objects: tuple[int, ...], kind: int) -> list[Frame]:
    """SDO writes that map a PDO with these objects; it is not valid during this."""
    mapping = index + 0x200
    return [
        sdo_write(index, 1, "I", 0xC0000000 | cob_id),
        sdo_write(mapping, 0, "B", 0),
        *(sdo_write(mapping, n, "I", one) for n, one in enumerate(objects, 1)),
        sdo_write(mapping, 0, "B", len(objects)),
        sdo_write(index, 2, "B", kind),
        sdo_write(index, 1, "I", cob_id),
    ]


def sdo_write(index: int, subindex: int, kind: str, value: float) -> Frame:
    data = struct.pack("<" + kind, value)
    head = struct.pack("<BHB", 0x23 | (4 - len(data)) << 2, index, subindex)
    return Frame(SDO_RX, head + data.ljust(4, b"\0"))


def sdo_read(index: int, subindex: int) -> Frame:
    return Frame(SDO_RX, struct.pack("<BHBI", 0x40, index, subindex, 0))
