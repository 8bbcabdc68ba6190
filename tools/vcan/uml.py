"""User-mode Linux: a Linux kernel that runs as an ordinary process, with the CAN modules in it.

Its root is the file system of the host, so that Python, virtual environment and working directory are the
same. Used by tools/vcan.
"""

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
    """No CAN is available, or it did not start; the message says what to do."""


class TimedOutError(VcanError):
    """The command exceeded its time limit."""


def which(program: str) -> str | None:
    """Path of a program, searched also in the folders of root."""
    return shutil.which(program, path=f"{os.environ.get('PATH', os.defpath)}:{SYSTEM_PATH}")


# --- what is installed


@dataclass(frozen=True)
class Machine:
    kernel: str
    release: str
    preload: bool  # load fpregs.c: the processor has more registers than this kernel can handle


def needs_preload(cpuinfo: str, release: str) -> bool:
    """Whether this kernel crashes on this processor unless fpregs.c is loaded into it."""
    version = tuple(int(part) for part in release.split("-")[0].split(".")[:2])
    flags = next((line for line in cpuinfo.splitlines() if line.startswith("flags")), "")
    return "amx_tile" in flags.split() and version < FPREGS_FIXED_IN


def find_machine() -> Machine:
    """The installed user-mode Linux; VcanError names the missing Debian packages."""
    missing = [package for program, package in PACKAGES.items() if which(program) is None]
    if missing:
        raise VcanError(f"apt-get install {' '.join(missing)}")
    kernel = which("linux.uml") or "linux.uml"
    said = subprocess.run([kernel, "--version"], capture_output=True, text=True, check=True)
    release = said.stdout.strip()  # e.g. 6.1.176
    preload = needs_preload(Path("/proc/cpuinfo").read_text(), release)
    if preload and which("cc") is None:
        raise VcanError("apt-get install gcc libc6-dev (this processor has AMX; see tools/vcan/fpregs.c)")
    if not (MODULE_ROOT / release).is_dir():
        raise VcanError(f"the user-mode Linux has no modules: there is no {MODULE_ROOT / release}")
    return Machine(kernel, release, preload)


# --- the text that boots it


def kernel_arguments(kernel: str, folder: Path, channel: str, console: str, *, quiet: bool) -> list[str]:
    """Command line of the kernel; console: destination of its log and /dev/tty0, in its syntax."""
    talk = ["quiet", "loglevel=0"] if quiet else ["loglevel=7"]
    # The kernel and its programs are processes of the host that stop each other at each system call and page
    # fault; one of them runs at a time. On one processor this is a context switch; with two, the other one
    # must wake up each time, which takes 3.5 times as long in a virtual machine.
    processor = max(os.sched_getaffinity(0))
    return [
        *("taskset", "--cpu-list", str(processor)),
        *("setpriv", "--pdeathsig", "TERM"),  # the kernel ends if this process is killed
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
    """Shell words that run the command with this working directory and the whole environment."""
    pairs = [f"{name}={value}" for name, value in os.environ.items()]
    return shlex.join(["env", "-i", f"--chdir={os.getcwd()}", *pairs, *command])


def run_line(command: Sequence[str], output: Path, errors: Path) -> str:
    """Shell line that runs the command, with output to files."""
    target = "2>&1" if errors == output else f"2>{shlex.quote(str(errors))}"
    return f"{as_here(command)} </dev/null >{shlex.quote(str(output))} {target}"


def shell_line(command: Sequence[str], size: os.terminal_size) -> str:
    """Shell lines that run an interactive command on the terminal, with job control."""
    stty = f"stty rows {size.lines} cols {size.columns} </dev/tty0"
    return f"{stty}\nsetsid -w -c {as_here(command)} </dev/tty0 >/dev/tty0 2>&1"


def memory_folder() -> str:
    """Folder for the memory file of the machine: it must have enough space, and allow execution."""
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
    """Write the input of init.sh: the modules, and the shell lines that it runs."""
    for script in SCRIPTS:
        shutil.copy(script, folder)
    for modules in ("lib/modules", "usr/lib/modules"):  # folder below -d, depends on the version of modprobe
        (folder / modules).parent.mkdir(parents=True)
        (folder / modules).symlink_to(MODULE_ROOT)
    # Arguments and environment may contain bytes that are not UTF-8: keep them unchanged.
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
    """The lines of a kernel log that show why it failed: those before a panic, else the last."""
    panic = next((number for number, line in enumerate(log) if "Kernel panic" in line), len(log) - 1)
    return log[max(0, panic - 11) : panic + 1]


def kill_group(process: subprocess.Popen[bytes]) -> None:
    """End a process that leads its own group, with all processes that it started."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def run(machine: Machine, command: Sequence[str], channel: str, timeout_s: float | None = None) -> int:
    """Run a command in a user-mode Linux and copy its output; returns its exit status.

    Its standard input is empty. TimedOutError after timeout_s seconds; None: no limit.
    """
    with run_folder() as folder:
        output = folder / "output"
        # If both outputs go to the same place, one file keeps their order.
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
    """Copy the output until the command has ended, or the kernel has stopped before it started."""
    start, console = time.monotonic(), folder / "console"
    while True:
        over = _is_over(process, folder)  # before copying, so that all output until the end is copied
        for source, sink in tails:
            shutil.copyfileobj(source, sink)  # output since the last round
            sink.flush()
        # A slow machine takes long to boot, but keeps writing.
        silence_s = time.time() - console.stat().st_mtime
        if over or (not (folder / "started").exists() and silence_s > BOOT_SILENCE_S):
            return
        if timeout_s is not None and time.monotonic() - start > timeout_s:
            raise TimedOutError(f"ended after {timeout_s:g} s (--timeout)")


def _is_over(process: subprocess.Popen[bytes], folder: Path) -> bool:
    """Whether the command has written its status, or the machine has ended; waits briefly."""
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(POLL_S)
    return process.poll() is not None or (folder / "status").exists()


def shell(machine: Machine, command: Sequence[str], channel: str) -> int:
    """Run an interactive command in a user-mode Linux on this terminal; returns its exit status."""
    import termios  # imported here: not all systems that import this file have it

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
