"""Kill a module at every system call of a save, and damage what it has saved.

    python -m tools.faults.saving.kills [--every N] [--json]

After each kill the module is switched on again: it must have the old parameters or the new ones, all
of them, and no alarm. Each file is then cut off at every length and each of its bits is flipped, every
N-th of them: the module must refuse it, raise the alarm of 6503h bit 12 with EMCY 6310h, have the
defaults of that group, and answer. Exit status 1 when it does anything else, 2 where a process may not
be traced. Linux only.
"""

from __future__ import annotations

import argparse
import json
import shutil
import struct
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from canfb.cia301.frame import Frame
from canfb.device.storage.image import ParameterGroup
from canfb.device.storage.storage import PARAMETERS
from canfb.hosting.state_files import StateFiles
from canfb.module.feedback_module import FeedbackModule
from canfb.module.module_config import ModuleConfig
from canfb.signal.correction import CorrectionTable
from tools.faults.saving.traced import NotTraced, killed_at

NODE_ID = 32
REQUEST, ANSWER, EMERGENCY = 0x600 + NODE_ID, 0x580 + NODE_ID, 0x80 + NODE_ID
SAVE, LOAD = b"save", b"load"
ALARM_PARAMETERS, BAD_DATA_SET = 1 << 12, 0x6310

Changes = Mapping[ParameterGroup, bytes | None]
Fingerprint = dict[ParameterGroup, str]


class Store:
    """The store of a folder that is opened when it is needed, so that a killed process lets it go."""

    def __init__(self) -> None:
        self.folder = Path()

    def load(self) -> Mapping[ParameterGroup, bytes | OSError]:
        with StateFiles(self.folder) as files:
            return files.load()

    def save(self, changes: Changes) -> None:
        with StateFiles(self.folder) as files:
            files.save(changes)


class Device:
    """A module with its store, and what a master does to it."""

    def __init__(self) -> None:
        self.store = Store()
        self.module = FeedbackModule(ModuleConfig(node_id=NODE_ID), self.store)

    def switch_on(self, folder: Path) -> list[Frame]:
        """Power-on with what the folder holds; the frames it sends."""
        self.store.folder = folder
        self.module.dictionary.reset(0x1000, 0xFFFF)
        return self.module.start(0.0)

    def write(self, index: int, subindex: int, data: bytes) -> bool:
        """SDO download, segmented where it is long; True if it was taken."""
        head = bytes([0x23 | (4 - len(data)) << 2 if len(data) <= 4 else 0x21])
        short = data if len(data) <= 4 else struct.pack("<I", len(data))
        taken = self._ask(head + struct.pack("<HB", index, subindex) + short.ljust(4, b"\0"))
        if len(data) <= 4 or not taken:
            return taken
        for n, start in enumerate(range(0, len(data), 7)):
            part = data[start : start + 7]
            last = start + 7 >= len(data)
            taken = self._ask(bytes([(n & 1) << 4 | (7 - len(part)) << 1 | last]) + part.ljust(7, b"\0"))
        return taken

    def answers(self) -> bool:
        """Whether an SDO upload of 1000h is answered."""
        return self._ask(bytes.fromhex("4000100000000000"))

    def fingerprint(self) -> Fingerprint:
        """The values of all parameters, by group, and the active table."""
        records = self.module.node.storage.entries.records
        return {group: repr(records(group, NODE_ID)) for group in PARAMETERS}

    @property
    def alarmed(self) -> bool:
        return bool(self.module.dictionary.entry(0x6503).value & ALARM_PARAMETERS)

    def _ask(self, request: bytes) -> bool:
        frames = self.module.receive(Frame(REQUEST, request), 0.0)
        return any(frame.can_id == ANSWER and frame.data[0] != 0x80 for frame in frames)


def configure(device: Device, variant: int) -> None:
    """Parameters of all groups, and a table: another set for each variant, 1 or 2."""
    phases = np.arange(128 * variant) / (128 * variant)
    table = CorrectionTable(phases + 0.004 * variant * np.sin(2 * np.pi * phases))
    writes = [
        (0x1017, 0, struct.pack("<H", 500 * variant)),
        (0x1800, 5, struct.pack("<H", 20 * variant)),
        (0x6001, 0, struct.pack("<I", 3600 * variant)),
        (0x6000, 0, struct.pack("<H", 4)),
        (0x2010, 3, bytes([5 + variant])),
        (0x2002, 1, struct.pack("<f", 10.0 * variant)),
        (0x2020, 1, table.to_bytes()),
        (0x2020, 3, struct.pack("<I", table.crc32)),
    ]
    for index, subindex, data in writes:
        if not device.write(index, subindex, data):
            raise RuntimeError(f"the module does not take {index:04X}h:{subindex:02X}")


@dataclass(frozen=True)
class Command:
    """What is killed."""

    name: str
    index: int
    subindex: int
    signature: bytes


COMMANDS = (
    Command("save all parameters", 0x1010, 1, SAVE),
    Command("save communication parameters", 0x1010, 2, SAVE),
    Command("save application parameters", 0x1010, 3, SAVE),
    Command("save manufacturer parameters", 0x1010, 4, SAVE),
    Command("load all defaults", 0x1011, 1, LOAD),
)


class Kills(NamedTuple):
    """What came out of the kills of one command."""

    command: str
    kills: int
    old: int
    new: int
    neither: int


class Damage(NamedTuple):
    """What came out of the damage of one file."""

    file: str
    cuts: int
    flips: int
    accepted: int


class Bench:
    """The folders, and the sets of parameters in them."""

    def __init__(self, root: Path) -> None:
        self._root = root
        self._old = root / "old"
        self._writer, self._reader = Device(), Device()
        self._writer.switch_on(self._old)
        self.defaults = self._writer.fingerprint()
        configure(self._writer, 1)
        if not self._writer.write(0x1010, 1, SAVE):
            raise RuntimeError("the module does not save")
        self.old = self._writer.fingerprint()
        configure(self._writer, 2)
        self.new = self._writer.fingerprint()

    def kill(self, command: Command) -> Kills:
        """Kill it at every stop."""
        after = self._after(command)
        outcomes: Counter[str] = Counter()
        place = 1
        while killed_at(lambda: self._do(command), self._prepare(place)):
            outcomes[self._outcome(after)] += 1
            place += 1
        return Kills(command.name, place - 1, outcomes["old"], outcomes["new"], outcomes["neither"])

    def damage(self, name: str, every: int) -> Damage:
        """Cut off and flip."""
        whole = (self._old / name).read_bytes()
        cuts = [whole[:length] for length in range(0, len(whole), every)]
        flips = [_flipped(whole, bit) for bit in range(0, 8 * len(whole), every)]
        group = ParameterGroup[name.removesuffix(".bin").upper()]
        accepted = sum(not self._refused(name, group, data) for data in (*cuts, *flips))
        return Damage(name, len(cuts), len(flips), accepted)

    def files(self) -> list[str]:
        """The files of the parameters."""
        return sorted(path.name for path in self._old.glob("*.bin"))

    def _prepare(self, place: int) -> int:
        self._copy_of_old()
        return place

    def _copy_of_old(self) -> Path:
        folder = self._root / "killed"
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(self._old, folder)
        self._writer.store.folder = folder
        return folder

    def _do(self, command: Command) -> None:
        if not self._writer.write(command.index, command.subindex, command.signature):
            raise RuntimeError(f"{command.name} was refused")

    def _after(self, command: Command) -> Fingerprint:
        if command.index == 0x1011:
            return self.defaults
        if command.subindex == 1:
            return self.new
        group = ParameterGroup(command.subindex)
        return self.old | {group: self.new[group]}

    def _outcome(self, after: Fingerprint) -> str:
        folder = self._root / "killed"
        self._reader.switch_on(folder)
        found = self._reader.fingerprint()
        if self._reader.alarmed or not self._reader.answers():
            return "neither"
        # A save after the kill works, whatever the kill has left.
        saved = self._reader.write(0x1010, 1, SAVE)
        self._reader.switch_on(folder)
        if not saved or self._reader.fingerprint() != found:
            return "neither"
        return "old" if found == self.old else "new" if found == after else "neither"

    def _refused(self, name: str, group: ParameterGroup, data: bytes) -> bool:
        folder = self._copy_of_old()
        (folder / name).write_bytes(data)
        frames = self._reader.switch_on(folder)
        told = any(
            frame.can_id == EMERGENCY and struct.unpack_from("<H", frame.data)[0] == BAD_DATA_SET
            for frame in frames
        )
        wanted = self.old | {group: self.defaults[group]}
        right = self._reader.fingerprint() == wanted
        return told and self._reader.alarmed and right and self._reader.answers()


def _flipped(data: bytes, bit: int) -> bytes:
    flipped = bytearray(data)
    flipped[bit // 8] ^= 1 << bit % 8
    return bytes(flipped)


def run(every: int, say: Callable[[str], None]) -> tuple[list[Kills], list[Damage]]:
    """All commands, all files."""
    with tempfile.TemporaryDirectory() as root:
        bench = Bench(Path(root))
        kills, damages = [], []
        for command in COMMANDS:
            kills.append(one := bench.kill(command))
            say(f"{one.command:32}{one.kills:6}{one.old:8}{one.new:8}{one.neither:8}")
        say(f"\n{'file':32}{'cuts':>6}{'flips':>8}{'accepted':>10}")
        for name in bench.files():
            damages.append(hurt := bench.damage(name, every))
            say(f"{hurt.file:32}{hurt.cuts:6}{hurt.flips:8}{hurt.accepted:10}")
    return kills, damages


def main(arguments: list[str] | None = None) -> int:
    """Run; the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m tools.faults.saving.kills", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument("--every", type=int, default=1, metavar="N", help="only every N-th cut and flip (1)")
    parser.add_argument("--json", action="store_true", help="for programs")
    options = parser.parse_args(arguments)
    if options.every < 1:
        parser.error("--every must be 1 or more")

    def say(line: str) -> None:
        if not options.json:
            print(line, flush=True)

    say(f"{'killed at every system call':32}{'kills':>6}{'old':>8}{'new':>8}{'neither':>8}")
    try:
        kills, damages = run(options.every, say)
    except NotTraced:
        print("this system lets no process be traced", file=sys.stderr)
        return 2
    good = not any(one.neither for one in kills) and not any(one.accepted for one in damages)
    if options.json:
        both = {"kills": [one._asdict() for one in kills], "damage": [one._asdict() for one in damages]}
        print(json.dumps(both | {"good": good}, indent=1))
    else:
        total = sum(one.kills for one in kills)
        say(f"\n{total} kills, {sum(one.old + one.new for one in kills)} with the old or the new set whole")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
