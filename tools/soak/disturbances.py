"""Disturbances of the network of the soak."""

import struct
from collections.abc import Callable

from canfb import CorrectionTable, Frame, objects as od
from canfb.cia301.codes import NmtCommand
from tools.soak.hosted import Hosted
from tools.soak.world import INTERFACE, INTERVAL_S, MODULE, OTHER, SAMPLES, SYNC, Setup, World, rests

EDS, NAME = (0x1021, 0), (0x1008, 0)
TABLE = CorrectionTable.identity(64)
FLOOD = [one for one in range(0x101, 0x7E0) if one & 0x7F not in (MODULE, INTERFACE, OTHER)]
LONGEST_GAP_S = 0.6
SHORT_STALL_S, LONG_STALL_S = 0.04, 0.4
"""The first fits into the socket, the second does not."""

Disturbance = Callable[[World], None]


def samples_lost(world: World) -> None:
    """Up to three successive ADC PDOs are lost; each must be counted."""
    world.recover()
    lost, before, interruptions = world.rng.randint(1, 3), world.missed(), world.interruptions
    world.cable.losing = lost
    world.pass_(0.02)
    beyond = world.missed() - before - lost
    if beyond and (beyond < 0 or interruptions == world.interruptions):  # a lost position may count more
        world.miss_count(abs(beyond), f"{lost} samples were lost, {lost + beyond} are counted")


def bus_off(world: World) -> None:
    """The controller is bus-off for some time, or the cable is unplugged, which nothing reports."""
    world.interrupt()
    device = world.hosted or world.module
    reported = world.rng.random() < 0.7
    for pulled, event in ((True, device.bus_off), (False, device.bus_back)):
        world.cable.pulled = pulled
        if world.hosted is not None:
            world.hosted.bus.full = pulled
        if reported:
            world.bus_event(event)
        if pulled:
            world.pass_(world.rng.uniform(0.002, LONGEST_GAP_S))


def nmt_pause(world: World) -> None:
    world.pause_begins()
    world.nmt(world.rng.choice((NmtCommand.STOP, NmtCommand.ENTER_PRE_OPERATIONAL)))
    world.bus.run_until(world.bus.now + world.rng.uniform(0.002, 0.09))
    world.nmt(NmtCommand.START)


def reset(world: World) -> None:
    while not rests(world.bus.now, 0.5):
        world.pass_(0.05)
    world.reset(world.rng.choice((NmtCommand.RESET_NODE, NmtCommand.RESET_COMMUNICATION)))


def node_goes(world: World) -> None:
    world.interrupt()
    world.other.pulled = True
    world.pass_(world.rng.uniform(0.2, 0.8))
    world.other.pulled = False


def interface_goes(world: World) -> None:
    """The encoder interface is stopped or reset, and started; there are no samples in the meantime."""
    world.pause_begins()
    command = world.rng.choice((NmtCommand.STOP, NmtCommand.RESET_NODE, NmtCommand.RESET_COMMUNICATION))
    world.bus.send(Frame(0x000, bytes((command, INTERFACE))))
    world.pass_(world.rng.uniform(0.002, 0.09))
    world.bus.send(Frame(0x000, bytes((NmtCommand.START, INTERFACE))))
    world.pass_(0.01)


def converter_fails(world: World) -> None:
    """The interface has no sample for some SYNCs, and reports it by EMCY."""
    world.machine.broken = True
    world.pass_(world.rng.uniform(0.002, 0.02))
    world.machine.broken = False
    world.pass_(0.01)


def eds_by_block(world: World) -> None:
    """A block upload of the EDS; one in three is not completed."""
    if world.rng.random() < 1.0 / 3.0:
        world.bus.send(Frame(0x600 + MODULE, struct.pack("<BHBBB2x", 0xA4, *EDS, 127, 0)))
        world.bus.send(Frame(0x600 + MODULE, b"\xa3".ljust(8, b"\0")))
        world.pass_(0.01)
    else:
        world.access.upload_domain(*EDS)


def table(world: World) -> None:
    """Activate a table by block download, or the identity."""
    if world.rng.random() < 0.5:
        world.access.download_domain(*od.TABLE_STAGED, TABLE.to_bytes())
        world.access.write(*od.TABLE_ACTIVATE, "I", TABLE.crc32)
    else:
        world.access.write(*od.TABLE_ACTIVATE, "I", 0)


def save(world: World) -> None:
    world.access.write_bytes(0x1010, 1, b"save", 1.0)


def reading(world: World) -> None:
    world.access.read_bytes(*NAME)
    for sub in range(1, 16):
        world.access.read_bytes(0x2012, sub)
    world.monitor.snapshot(world.bus.now)


def flood(world: World) -> None:
    """A faulty master: some hundred simultaneous frames with random content, and SDO reads."""
    rng = world.rng
    for _ in range(rng.randint(50, 400)):
        if rng.random() < 0.3:
            data = struct.pack("<BI3x", 0x40, rng.randrange(1 << 24))
            world.bus.send(Frame(0x600 + MODULE, data))
        else:
            remote = rng.random() < 0.05
            data = b"" if remote else rng.randbytes(rng.randint(0, 8))
            world.bus.send(Frame(rng.choice(FLOOD), data, remote))


def short_frames(world: World) -> None:
    world.bus.send(Frame(SYNC, b"\1\2"))
    world.bus.send(Frame(SAMPLES, b"\1"))
    world.bus.send(Frame(0x000, b"\1"))


def extra_syncs(world: World) -> None:
    """A second producer: additional SYNCs, for each of which the interface sends a sample.

    Only in the first half of the interval: later, only receive times would show that they are additional
    (docs/evidence.md).
    """
    if world.rng.random() < 0.5:
        world.pause_begins()
    world.interruptions += 1
    for _ in range(world.rng.randint(1, 30)):
        sync_s = world.producer.deadline() or world.bus.now
        world.bus.run_until(sync_s + world.rng.uniform(0.05, 0.45) * INTERVAL_S)
        world.bus.send(Frame(SYNC, b""))
    world.pass_(0.02)


def clock_set(world: World) -> None:
    world.cable.stamp_s = world.rng.choice((0.0, 3600.0))


def clock_behind(world: World) -> None:
    world.cable.stamp_s = world.rng.choice((0.0, -3600.0))


def stall(world: World) -> None:
    """The process does not run; all frames wait in its socket."""
    hosted_of(world).stalled_until_s = world.bus.now + world.rng.uniform(0.001, SHORT_STALL_S)
    world.pass_(2.0 * SHORT_STALL_S)


def long_stall(world: World) -> None:
    """The process does not run for so long (or is stopped by SIGSTOP) that its socket overflows."""
    world.interrupt()
    hosted_of(world).stalled_until_s = world.bus.now + world.rng.uniform(SHORT_STALL_S, LONG_STALL_S)
    world.pass_(2.0 * LONG_STALL_S)


def link_down(world: World) -> None:
    """`ip link set can0 down`, and up again."""
    world.interrupt()
    hosted = hosted_of(world)
    world.bus_event(hosted.down)
    world.pass_(world.rng.uniform(0.002, LONGEST_GAP_S))
    world.bus_event(hosted.bus_back)


def queue_full(world: World) -> None:
    socket = hosted_of(world).bus
    socket.full = True
    world.pass_(world.rng.uniform(0.001, 0.3))
    socket.full = False
    world.pass_(0.01)


def wall_clock_set(world: World) -> None:
    """The wall clock is set by an hour, by a fraction of an interval, or slewed; forward or back."""
    hosted_of(world).set_s += world.rng.choice((3600.0, -3600.0, 0.3, -0.3, 2e-3, -2e-3, 3e-4, -3e-4))
    world.pass_(0.02)


def hosted_of(world: World) -> Hosted:
    if world.hosted is None:
        raise TypeError("the module of this set-up has no process")
    return world.hosted


ALWAYS: tuple[Disturbance, ...] = (
    *(samples_lost, bus_off, nmt_pause, reset, node_goes, interface_goes, converter_fails),
    *(eds_by_block, table, save, reading, flood, short_frames, extra_syncs),
)
OF_STAMPS: tuple[Disturbance, ...] = (clock_set, clock_behind)
OF_A_PROCESS: tuple[Disturbance, ...] = (stall, long_stall, link_down, queue_full, wall_clock_set)


def disturbances_of(setup: Setup) -> dict[str, Disturbance]:
    chosen = ALWAYS + OF_STAMPS * setup.stamps + OF_A_PROCESS * setup.hosted
    return {one.__name__: one for one in chosen}
