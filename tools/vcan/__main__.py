"""Run a command where a real SocketCAN interface vcan0 exists.

    python -m tools.vcan run -- COMMAND...    run it, pass its output through, exit with its status
    python -m tools.vcan check                say what there is: kernel, uml or none (exit status 1)
    python -m tools.vcan shell                an interactive shell in it

The kernel's own vcan is used where it has one, with or without root. Elsewhere the command runs in
Debian's user-mode Linux, with the same files, the same environment and the same working directory.
COMMAND gets no standard input. Exit status 124: ended by --timeout; 125: no vcan, or it failed to start.
"""

import argparse
import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import NoReturn

from tools.vcan import uml
from tools.vcan.uml import Machine, TimedOutError, VcanError, which

CHANNEL = "vcan0"
PROBE = "vcanprobe"
TIMED_OUT, FAILED = 124, 125
GRACE_S = 10.0
ARPHRD_CAN = "280"
IFF_UP = 1
NETWORK = Path(__file__).with_name("network.sh")
# Prefix of a command that runs it in its own network namespace, with the channel, without root.
PREFIX = ("unshare", "--map-root-user", "--net", "sh", str(NETWORK), CHANNEL)


@dataclass(frozen=True)
class Kernel:
    detail: str
    prefix: tuple[str, ...] = ()

    @contextlib.contextmanager
    def interface(self) -> Iterator[None]:
        """Context with CHANNEL up, restored afterwards; a prefix, if any, does this itself."""
        state = "up" if self.prefix else interface_state(CHANNEL)
        if state is None and not _succeeds("ip", "link", "add", "dev", CHANNEL, "type", "vcan"):
            raise VcanError(f"ip link add dev {CHANNEL} type vcan: failed")
        if state != "up" and not _succeeds("ip", "link", "set", CHANNEL, "up"):
            raise VcanError(f"ip link set {CHANNEL} up: failed")
        try:
            yield
        finally:
            if state is None:
                _succeeds("ip", "link", "del", "dev", CHANNEL)
            elif state == "down":
                _succeeds("ip", "link", "set", CHANNEL, "down")


def interface_state(name: str) -> str | None:
    """State of a CAN interface, "up" or "down"; None if it does not exist."""
    folder = Path("/sys/class/net", name)
    try:
        kind = (folder / "type").read_text().strip()
        flags = int((folder / "flags").read_text(), 16)
    except OSError:
        return None
    if kind != ARPHRD_CAN:
        return None
    return "up" if flags & IFF_UP else "down"


def find_kernel() -> Kernel | None:
    if interface_state(CHANNEL) == "up":
        return Kernel(f"{CHANNEL} is up")
    if which("ip") is None:
        return None
    if _succeeds("ip", "link", "add", "dev", PROBE, "type", "vcan"):
        _succeeds("ip", "link", "del", "dev", PROBE)
        return Kernel(f"{CHANNEL} is made for the run")
    if which("unshare") is not None and _succeeds(*PREFIX, "true"):
        return Kernel(f"{CHANNEL} is made for the run, in a network namespace", PREFIX)
    return None


def _succeeds(*command: str) -> bool:
    path = which(command[0]) or command[0]
    done = subprocess.run([path, *command[1:]], stdin=subprocess.DEVNULL, capture_output=True, check=False)
    return done.returncode == 0


def find() -> Kernel | Machine:
    """The best available vcan on this machine; VcanError says what to install."""
    kernel = find_kernel()
    if kernel is not None:
        return kernel
    try:
        return uml.find_machine()
    except VcanError as error:
        raise VcanError(f"this kernel has no vcan, and no user-mode Linux can be booted: {error}") from error


def run_in_kernel(kernel: Kernel, command: Sequence[str], timeout_s: float | None) -> int:
    """Run a command with the vcan of the kernel; returns its exit status."""
    with kernel.interface():
        process = subprocess.Popen(
            [*kernel.prefix, *command], stdin=subprocess.DEVNULL, start_new_session=True
        )
        try:
            return shell_status(process.wait(timeout_s))
        except subprocess.TimeoutExpired:
            raise TimedOutError(f"ended after {timeout_s:g} s (--timeout)") from None
        except KeyboardInterrupt:
            # The command has its own session: pass Ctrl-C on, and wait for its last output.
            os.killpg(process.pid, signal.SIGINT)
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(GRACE_S)
            raise
        finally:
            uml.kill_group(process)


def shell_status(returncode: int) -> int:
    """Exit status as in a shell: 128 + number for a signal."""
    return 128 - returncode if returncode < 0 else returncode


def run(command: Sequence[str], timeout_s: float | None) -> int:
    way = find()
    if isinstance(way, Kernel):
        return run_in_kernel(way, command, timeout_s)
    return uml.run(way, command, CHANNEL, timeout_s)


def check() -> int:
    """Print in one line what is available; returns 0 if a command can be run with a vcan, else 1."""
    try:
        way = find()
        if isinstance(way, Kernel):
            print(f"kernel: {way.detail}")
            return 0
        start = time.monotonic()
        status = uml.run(way, ["true"], CHANNEL)
    except VcanError as error:
        print("none:", " ".join(str(error).split()))
        return 1
    print(f"uml: user-mode Linux {way.release} boots in {time.monotonic() - start:.1f} s")
    return status


def shell() -> int:
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        raise VcanError("shell needs a terminal; use: run -- COMMAND")
    way = find()
    command = ["bash", "-i"]
    if isinstance(way, Kernel):
        with way.interface():
            return shell_status(subprocess.run([*way.prefix, *command], check=False).returncode)
    print(f"user-mode Linux {way.release} with {CHANNEL}; leave it with exit", flush=True)
    return uml.shell(way, command, CHANNEL)


def parse(arguments: Sequence[str]) -> argparse.Namespace:
    usage, _, _ = (__doc__ or "").partition("\n")
    parser = argparse.ArgumentParser(prog="python -m tools.vcan", description=usage)
    commands = parser.add_subparsers(dest="action", required=True)
    commands.add_parser("check", help="say what there is: kernel, uml or none")
    commands.add_parser("shell", help=f"an interactive shell where {CHANNEL} exists")
    runner = commands.add_parser("run", help=f"run a command where {CHANNEL} exists")
    runner.add_argument("--timeout", type=float, metavar="SECONDS", help="default: none")
    runner.add_argument("command", nargs=argparse.REMAINDER, metavar="-- COMMAND...")
    options = parser.parse_args(arguments)
    if options.action == "run":
        if options.command[:1] == ["--"]:
            del options.command[0]
        if not options.command:
            parser.error("run needs a command: run -- COMMAND...")
    return options


def _end(number: int, _frame: FrameType | None) -> NoReturn:
    raise SystemExit(128 + number)


def main(arguments: Sequence[str]) -> int:
    options = parse(arguments)
    try:
        if options.action == "check":
            return check()
        if options.action == "shell":
            return shell()
        return run(options.command, options.timeout)
    except TimedOutError as error:
        print(f"vcan: {error}", file=sys.stderr)
        return TIMED_OUT
    except (VcanError, FileNotFoundError) as error:
        print(f"vcan: {error}", file=sys.stderr)
        return FAILED
    except KeyboardInterrupt:
        return 128 + signal.SIGINT
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # the reader has ended: avoid an error at exit
        return 128 + signal.SIGPIPE


if __name__ == "__main__":
    for ending in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(ending, _end)
    sys.exit(main(sys.argv[1:]))
