"""What the machine can do, from which every limit of these tests comes.

A user-mode Linux takes 13 µs and more for a system call, and other work may take the processor away. So
no test says how long something takes: it waits for what must happen, and gives up when nothing has happened
for a time in which this machine does many times as much. The simulated machine turns in slow motion, by one
period with each SYNC (`pace: sync`), and its samples say so (`times: true`). A test in true time says that it
is one, and takes its rate from here.
"""

import subprocess
import sys
import time
from dataclasses import dataclass
from statistics import median

import can

LEAST_PATIENCE_S = 60.0
ROUNDS = 50
IMPORTS = "import canfb.cli.run, canfb.cli.simulate, canfb.cli.calibrate, canopen, can, numpy, yaml"


@dataclass(frozen=True)
class Pace:
    """Measured times, and what follows from them."""

    round_trip_s: float
    """A frame from one socket to another one, with python-can, while nothing else is on the bus."""
    process_s: float
    """A python process with the imports of a command, from its start to its end."""

    @property
    def patience_s(self) -> float:
        """For how long nothing may happen until a test gives up, seconds."""
        return max(LEAST_PATIENCE_S, 30.0 * self.process_s, 20_000.0 * self.round_trip_s)

    @property
    def answer_s(self) -> float:
        """How long a command waits for an SDO answer, seconds; more than 60 they do not take."""
        return min(60.0, self.patience_s)

    @property
    def rate_hz(self) -> float:
        """A SYNC rate at which several processes on the bus are idle most of the time."""
        return min(200.0, max(1.0, 0.02 / self.round_trip_s))

    @property
    def period_s(self) -> float:
        """The SYNC period of a machine in slow motion; each SYNC may be much later."""
        return max(0.02, 1.0 / self.rate_hz)

    def slower(self, seconds: float) -> float:
        """A time that suits a machine with a round trip of 0.1 ms, on this one; never less."""
        return seconds * max(1.0, self.round_trip_s / 1e-4, self.process_s)

    def __str__(self) -> str:
        return (
            f"this machine: a round trip over vcan takes {1e3 * self.round_trip_s:.2f} ms, a python process "
            f"{self.process_s:.1f} s; SYNC at {self.rate_hz:.3g} Hz, patience {self.patience_s:.0f} s"
        )


def measure(channel: str) -> Pace:
    """Measure it: some tens of round trips, and one process."""
    trips = []
    frame = can.Message(arbitration_id=0x7F0, is_extended_id=False)
    with (
        can.Bus(interface="socketcan", channel=channel) as one,
        can.Bus(interface="socketcan", channel=channel) as other,
    ):
        for _ in range(ROUNDS):
            start = time.perf_counter()
            one.send(frame)
            other.recv()
            trips.append(time.perf_counter() - start)
    start = time.perf_counter()
    subprocess.run([sys.executable, "-c", IMPORTS], check=True)
    return Pace(median(trips), time.perf_counter() - start)
