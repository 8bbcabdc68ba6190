"""User-mode Linux: a Linux kernel that runs as an ordinary process, with the CAN modules in it.

It is booted with the machine's own files as its root, so the same Python, the same virtual
environment and the same working directory are there. Used by tools/vcan.
"""

from __future__ import annotations

import contextlib
import os
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from io import FileIO
from pathlib import Path
from typing import BinaryIO

MODULE_ROOT = Path("/usr/lib/uml/modules")
MEMORY_MIB, MEMORY_FOLDERS = 1024, ("/dev/shm", "/tmp", "/var/tmp")
BOOT_SILENCE_S = 60.0
POLL_S = 0.02
SYSTEM_PATH = "/usr/local/sbin:/usr/sbin:/sbin"

PACKAGES = {
    "linux.uml": "user-mode-linux",
    "modprobe": "kmod",
    "ip": "iproute2",
    "mount": "mount",
    "setpriv": "util-linux",
    "taskset": "util-linux",
}
FPREGS_SOURCE = Path(__file__).with_name("fpregs.c")
SCRIPTS = [Path(__file__).with_name(name) for name in ("init.sh", "network.sh")]
FPREGS_FIXED_IN = (6, 13)


class VcanError(Exception):
    """No CAN can be had, or it did not start; the message says what to do."""


class TimedOutError(VcanError):
    """The command ran longer than it may."""


def which(program: str) -> str | None:
    """Path of a program, looked for in the administrator's folders too."""
    return shutil.which(program, path=f"{os.environ.get('PATH', os.defpath)}:{SYSTEM_PATH}")


# --- what is installed


@dataclass(frozen=True)
class Machine:
    kernel: str
    release: str
    preload: bool  # the processor has more registers than this kernel can handle: fpregs.c


def needs_preload(cpuinfo: str, release: str) -> bool:
    """Whether this kernel dies on this processor unless fpregs.c is loaded into it."""
    version = tuple(int(part) for part in release.split("-")[0].split(".")[:2])
    flags = next((line for line in cpuinfo.splitlines() if line.startswith("flags")), "")
    return "amx_tile" in flags.split() and version < FPREGS_FIXED_IN


def find_machine() -> Machine:
    """The installed user-mode Linux; a VcanError says which Debian packages are missing."""
    missing = [package for program, package in PACKAGES.items() if which(program) is None]
    if missing:
        raise VcanError(f"apt-get install {' '.join(missing)}")
    kernel = which("linux.uml") or "linux.uml"
    said = subprocess.run([kernel, "--version"], capture_output=True, text=True, check=True)
    release = said.stdout.strip()  # as in 6.1.176
    preload = needs_preload(Path("/proc/cpuinfo").read_text(), release)
    if preload and which("cc") is None:
        raise VcanError("apt-get install gcc libc6-dev (this processor has AMX; see tools/vcan/fpregs.c)")
    if not (MODULE_ROOT / release).is_dir():
        raise VcanError(f"the user-mode Linux has no modules: there is no {MODULE_ROOT / release}")
    return Machine(kernel, release, preload)


# --- the text that boots it


def kernel_arguments(kernel: str, folder: Path, channel: str, console: str, *, quiet: bool) -> list[str]:
    """Command line of the kernel; console is where its log and /dev/tty0 go, in its own words."""
    talk = ["quiet", "loglevel=0"] if quiet else ["loglevel=7"]
    # The kernel and its programs are processes here that stop each other at each system call and page fault:
    # one of them runs at a time. On one processor that is a switch; on two the other one has to wake up each
    # time, which in a virtual machine takes 3.5 times as long.
    processor = max(os.sched_getaffinity(0))
    return [
        *("taskset", "--cpu-list", str(processor)),
        *("setpriv", "--pdeathsig", "TERM"),  # nothing stays when this process is killed: it then ends itself
        kernel,
        f"mem={MEMORY_MIB}M",
        "rootfstype=hostfs",
        "rootflags=/",
        "rw",
        *talk,
        f"uml_dir={folder}/",
        "con=null",
        f"con0={console}",
        "ssl=null",
        "init=/bin/sh",
        *("--", str(folder / "init.sh"), channel),
    ]


def as_here(command: Sequence[str]) -> str:
    """Words of shell that run the command with this working directory and this whole environment."""
    pairs = [f"{name}={value}" for name, value in os.environ.items()]
    return shlex.join(["env", "-i", f"--chdir={os.getcwd()}", *pairs, *command])


def run_line(command: Sequence[str], output: Path, errors: Path) -> str:
    """Line of shell that runs the command, its output into files."""
    target = "2>&1" if errors == output else f"2>{shlex.quote(str(errors))}"
    return f"{as_here(command)} </dev/null >{shlex.quote(str(output))} {target}"


def shell_line(command: Sequence[str], size: os.terminal_size) -> str:
    """Lines of shell that run an interactive command on the terminal, with job control."""
    stty = f"stty rows {size.lines} cols {size.columns} </dev/tty0"
    return f"{stty}\nsetsid -w -c {as_here(command)} </dev/tty0 >/dev/tty0 2>&1"


def memory_folder() -> str:
    """Folder for the file that is the machine's memory: it needs the room, and must allow execution."""
    for folder in MEMORY_FOLDERS:
        with contextlib.suppress(OSError):
            state = os.statvfs(folder)
            room = state.f_bavail * state.f_frsize
            if room >= MEMORY_MIB << 20 and not state.f_flag & os.ST_NOEXEC and os.access(folder, os.W_OK):
                return folder
    raise VcanError(
        f"no folder with {MEMORY_MIB} MiB free that allows execution: {', '.join(MEMORY_FOLDERS)}"
    )


# --- a run


@contextlib.contextmanager
def run_folder() -> Iterator[Path]:
    """Private folder for one run, at the same path outside and inside (/dev, /proc and /sys differ there)."""
    with tempfile.TemporaryDirectory(prefix="vcan-", dir="/tmp") as name:
        yield Path(name)


def _host_environment(machine: Machine, folder: Path) -> dict[str, str]:
    environment = {**os.environ, "TMPDIR": memory_folder()}
    if machine.preload:
        library = folder / "fpregs.so"
        compiler = which("cc") or "cc"
        subprocess.run([compiler, "-O2", "-shared", "-fPIC", "-o", library, FPREGS_SOURCE], check=True)
        environment["LD_PRELOAD"] = str(library)
    return environment


def _prepare(folder: Path, run: str) -> None:
    """What init.sh needs: the modules, and the lines of shell that it runs."""
    for script in SCRIPTS:
        shutil.copy(script, folder)
    for modules in ("lib/modules", "usr/lib/modules"):  # below -d, by the version of modprobe
        (folder / modules).parent.mkdir(parents=True)
        (folder / modules).symlink_to(MODULE_ROOT)
    # Arguments and environment may hold bytes that are no UTF-8: keep them as they are.
    (folder / "command").write_text(f"{run}\n", encoding="utf-8", errors="surrogateescape")


def _exit_status(folder: Path) -> int:
    try:
        text = (folder / "status").read_text().strip()
    except FileNotFoundError:
        text = "failed"
    if text.isdecimal():
        return int(text)
    console = folder / "console"
    log = console.read_text(errors="replace").splitlines() if console.exists() else []
    raise VcanError("\n    ".join(["the user-mode Linux failed; from its log:", *last_words(log)]))


def last_words(log: Sequence[str]) -> Sequence[str]:
    """The lines of a kernel's log that say why it failed: before a panic, else the last."""
    panic = next((number for number, line in enumerate(log) if "Kernel panic" in line), len(log) - 1)
    return log[max(0, panic - 11) : panic + 1]


def kill_group(process: subprocess.Popen[bytes]) -> None:
    """End a process that leads its own group, and all that it started; nothing of it is left."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def run(machine: Machine, command: Sequence[str], channel: str, timeout_s: float | None = None) -> int:
    """Run a command in a user-mode Linux and copy its output; returns its exit status.

    Its standard input is empty. Raises TimedOutError after timeout_s seconds; None waits for ever.
    """
    with run_folder() as folder:
        output = folder / "output"
        # One file for both where both go to the same place: their order is kept.
        errors = output if os.path.sameopenfile(1, 2) else folder / "errors"
        _prepare(folder, run_line(command, output, errors))
        sinks = {errors: sys.stderr.buffer, output: sys.stdout.buffer}
        for path in sinks:
            path.touch()
        with (folder / "console").open("wb") as console:
            process = subprocess.Popen(
                kernel_arguments(machine.kernel, folder, channel, "null,fd:1", quiet=False),
                stdin=subprocess.DEVNULL,
                stdout=console,
                stderr=console,
                env=_host_environment(machine, folder),
                start_new_session=True,
            )
        with contextlib.ExitStack() as stack:
            stack.callback(kill_group, process)
            tails = [
                (stack.enter_context(path.open("rb", buffering=0)), sink) for path, sink in sinks.items()
            ]
            _relay(process, folder, tails, timeout_s)
        return _exit_status(folder)


def _relay(
    process: subprocess.Popen[bytes],
    folder: Path,
    tails: Sequence[tuple[FileIO, BinaryIO]],
    timeout_s: float | None,
) -> None:
    """Copy the output until the command has ended, or the kernel stops before it has started."""
    start, console = time.monotonic(), folder / "console"
    while True:
        over = _is_over(process, folder)  # asked first: what was written until then is copied
        for source, sink in tails:
            shutil.copyfileobj(source, sink)  # what was written meanwhile
            sink.flush()
        # A slow machine takes long to boot, but goes on writing.
        silence_s = time.time() - console.stat().st_mtime
        if over or (not (folder / "started").exists() and silence_s > BOOT_SILENCE_S):
            return
        if timeout_s is not None and time.monotonic() - start > timeout_s:
            raise TimedOutError(f"ended after {timeout_s:g} s (--timeout)")


def _is_over(process: subprocess.Popen[bytes], folder: Path) -> bool:
    """Whether the command has left its status, or the machine is gone; waits a little for it."""
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(POLL_S)
    return process.poll() is not None or (folder / "status").exists()


def shell(machine: Machine, command: Sequence[str], channel: str) -> int:
    """Run an interactive command in a user-mode Linux on this terminal; returns its exit status."""
    import termios  # not there on every system that can import this file

    settings = termios.tcgetattr(0)
    with run_folder() as folder:
        _prepare(folder, shell_line(command, os.get_terminal_size(0)))
        arguments = kernel_arguments(machine.kernel, folder, channel, "fd:0,fd:1", quiet=True)
        process = subprocess.Popen(arguments, env=_host_environment(machine, folder), process_group=0)
        try:
            _to_foreground(process.pid)
            while not _is_over(process, folder):
                pass
        finally:
            kill_group(process)
            _to_foreground(os.getpgrp())
            termios.tcsetattr(0, termios.TCSADRAIN, settings)
        return _exit_status(folder)


def _to_foreground(group: int) -> None:
    previous = signal.signal(signal.SIGTTOU, signal.SIG_IGN)
    try:
        os.tcsetpgrp(0, group)
    finally:
        signal.signal(signal.SIGTTOU, previous)
