"""An ADC as the kernel shows it: a tree in sysfs and a character device, for libiio's local backend.

    python emulated_iio_tree.py MILLISECONDS COMMAND...    run the command where this ADC is; needs the rights
                                                           of root

The tree lies on /sys/bus of a mount namespace of its own, the character device is a pipe. Each firing of the
sysfs trigger gives one scan of a machine whose position everybody knows. By their time stamps the scans are
so many milliseconds apart, whatever the time is.
"""

import os
import signal
import struct
import subprocess
import sys
import tempfile
import threading
from pathlib import Path

import numpy as np

from canfb.simulation.encoder import Encoder, Motion, Ramp

INTERVAL_S = 1e-3  # of the motion
MIDDLE, SHIFT = 2048, 4
DEVICES = Path("/sys/bus/iio/devices")
ADC, TRIGGER = "iio:device0", "trigger0"
FILES = {
    f"{ADC}/name": "ads7950",
    f"{ADC}/current_timestamp_clock": "realtime",
    f"{ADC}/scan_elements/in_timestamp_en": "0",
    f"{ADC}/scan_elements/in_timestamp_index": "4",
    f"{ADC}/scan_elements/in_timestamp_type": "le:s64/64>>0",
    f"{ADC}/buffer/length": "0",
    f"{ADC}/buffer/enable": "0",
    f"{ADC}/buffer/watermark": "0",
    f"{ADC}/trigger/current_trigger": "",
    f"{TRIGGER}/name": "sysfstrig0",
} | {
    name: text
    for n in range(4)
    for name, text in {
        f"{ADC}/in_voltage{n}_raw": "0",
        f"{ADC}/scan_elements/in_voltage{n}_en": "0",
        f"{ADC}/scan_elements/in_voltage{n}_index": f"{n}",
        f"{ADC}/scan_elements/in_voltage{n}_type": f"be:u12/16>>{SHIFT}",
    }.items()
}
NODES = ("null", "zero", "full", "random", "urandom", "tty")


def position_cycles(number: int) -> float:
    """Where the machine is at scan ``number``, from 0: at most a quarter of a cycle further each time."""
    return Motion((Ramp(0.05, 0.0), Ramp(0.2, 6.0))).revolutions(number * INTERVAL_S) * 2500


def scans(period_ms: float) -> list[bytes]:
    """All scans that there will be: sine, cosine, time stamp, as the kernel lays them out."""
    encoder, rng = Encoder(noise_lsb=0.5), np.random.default_rng(3)
    found = []
    for number in range(5000):
        counts = encoder.sample(position_cycles(number), rng)
        words = [int(count) + MIDDLE << SHIFT for count in counts]
        found.append(struct.pack(">HH4x", *words) + struct.pack("<q", round(number * period_ms * 1e6)))
    return found


def mount(*arguments: str) -> None:
    subprocess.run(["mount", *arguments], check=True)


def make_tree() -> None:
    mount("-t", "tmpfs", "none", "/sys/bus")
    for name, text in FILES.items():
        path = DEVICES / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(f"{text}\n")
    (DEVICES / TRIGGER / "trigger_now").write_text("")
    (DEVICES / TRIGGER / "trigger_now").chmod(0o200)


def make_character_device() -> int:
    """In a /dev of its own; the end of the pipe that the ADC writes into."""
    folder = Path(tempfile.mkdtemp())
    mount("-t", "tmpfs", "none", str(folder))
    for name in NODES:
        if Path("/dev", name).exists():
            (folder / name).touch()
            mount("--bind", f"/dev/{name}", str(folder / name))
    os.mkfifo(folder / ADC)
    (folder / "shm").mkdir(mode=0o1777)
    mount("--move", str(folder), "/dev")
    folder.rmdir()
    return os.open(f"/dev/{ADC}", os.O_RDWR)


def serve(pipe: int, all_scans: list[bytes], over: threading.Event) -> None:
    """A scan for each time that somebody writes to trigger_now, while the buffer is enabled."""
    fired = DEVICES / TRIGGER / "trigger_now"
    left = iter(all_scans)
    while not over.wait(0.0003):
        if fired.stat().st_size:
            os.truncate(fired, 0)
            assert (DEVICES / ADC / "buffer/enable").read_text().startswith("1")
            os.write(pipe, next(left))


def main(period_ms: float, command: list[str]) -> int:
    make_tree()
    pipe = make_character_device()
    over = threading.Event()
    thread = threading.Thread(target=serve, args=(pipe, scans(period_ms), over))
    thread.start()
    child = subprocess.Popen(command)
    signal.signal(signal.SIGTERM, lambda number, frame: child.terminate())
    try:
        return child.wait()
    finally:
        over.set()
        thread.join()


if __name__ == "__main__":
    sys.exit(main(float(sys.argv[1]), sys.argv[2:]))
