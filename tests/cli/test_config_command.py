"""`canfb config`: the example is itself valid, and what is wrong is told, also for this machine."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import can
import pytest

import canfb
from canfb.bus.opening import check_words
from canfb.errors import ConfigError
from commands import Command


@pytest.fixture
def example(command: Command) -> str:
    out, err = command("config example")
    assert err == ""
    return out


def test_the_example_is_itself_valid(example: str, tmp_path: Path, command: Command) -> None:
    path = tmp_path / "example.yaml"
    path.write_text(example)
    assert command("config check", path) == (f"{path}: valid; modules: 20h\n", "")
    config = canfb.load_config(path)
    assert config.bus["interface"] == "socketcan"
    assert config.modules == [
        canfb.ModuleConfig(
            node_id=0x20,
            times=True,
            residual_limit=0.3333,
            max_acceleration_rad_s2=0.25,
            coast_samples=30,
            sync_timeout_periods=20,
        )
    ]
    assert config.simulation.motion.rpm == 61


def test_what_the_example_has_in_comments_is_valid_too(example: str, tmp_path: Path) -> None:
    """The keys that are shown but left out: without their marks they must load."""
    path = tmp_path / "example.yaml"
    lines = []
    for line in example.splitlines():
        stripped = line.lstrip()
        shown = stripped.startswith(
            ("# conditioning:", "#   {", "# realtime:", "# predict:", "# state_dir:", "# source:", "# drive:")
        )
        words = stripped.removeprefix("# ").partition(" # ")[0].partition("   # offset")[0]
        indent = " " * (len(line) - len(stripped))
        lines.append(f"{indent}{words}" if shown else line)
    path.write_text("\n".join(lines))
    config = canfb.load_config(path)
    assert config.realtime.priority == 80
    module = config.modules[0]
    assert module.conditioning == canfb.Conditioning()
    assert (module.predict, module.state_dir) == (True, "/var/lib/canfb/x")
    assert module.source is not None
    assert module.source.kind == "iio"
    assert config.simulation.drive is not None


MODULES = "modules:\n  - node_id: 32\n"


@pytest.fixture
def checked(tmp_path: Path, command: Command) -> Callable[..., str]:
    """What is said of a configuration, behind the name of its file."""

    def check(text: str, code: int = 2) -> str:
        path = tmp_path / "feedback.yaml"
        path.write_text(text)
        (line,) = "".join(command("config check", path, code=code)).splitlines()
        return line.removeprefix("canfb: ").removeprefix(str(path))

    return check


WRONG = {
    f"bus: {{interface: socketcann}}\n{MODULES}": (
        ":1: unknown interface 'socketcann' in bus; did you mean 'socketcan'?"
    ),
    f"bus:\n  interface: socketcan\n  chanel: can0\n{MODULES}": (
        ":3: unknown key 'chanel' in bus for socketcan; did you mean 'channel'?"
    ),
    f"bus:\n  interface: socketcan\n  bitrate: 1M\n{MODULES}": (
        ":3: bitrate in bus must be bits per second, such as 1000000, not '1M'"
    ),
    f"bus:\n  interface: virtual\n  receive_own_messages: true\n{MODULES}": (
        ":3: receive_own_messages: omit it; a device must not receive its own frames"
    ),
    f"{MODULES}    source:\n      kind: recording\n      file: /nowhere/tracks.csv\n": (
        ":5: file /nowhere/tracks.csv of source cannot be read: No such file or directory"
    ),
    f"{MODULES}    state_dir: /dev/null/x\n": (
        ":3: state_dir /dev/null/x cannot be used: /dev/null is not a folder"
    ),
    f"{MODULES}realtime:\n  cpu: 65535\n": ":4: cpu 65535 in realtime: this machine has 1, 0 to 0",
    f"{MODULES}realtime: {{cpu: 0, busy_poll: true}}\n": (
        ":3: busy_poll in realtime: this machine has one processor, which all programs share"
    ),
}


@pytest.mark.parametrize("text", WRONG)
def test_what_cannot_be_on_this_machine(
    text: str, checked: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "cpu_count", lambda: 1)
    assert checked(text) == WRONG[text]


@pytest.mark.parametrize(
    "bus",
    [
        "{}",
        "{channel: can0, bitrate: 500000}",
        "{interface: socketcan, channel: can0, local_loopback: false}",
        "{interface: kvaser, channel: 0, bitrate: 500000, accept_virtual: true}",
        "{interface: pcan, channel: PCAN_USBBUS1, fd: true, f_clock_mhz: 80, nom_brp: 1, auto_reset: true}",
        "{interface: slcan, channel: /dev/ttyUSB0, bitrate: 1000000, tty_baudrate: 115200}",
        "{interface: ixxat, channel: 0, bitrate: 1000000, unique_hardware_id: HW1}",
        "{interface: gs_usb, channel: 0, bus: 1, address: 2, bitrate: 1000000}",
        "{interface: vector, channel: 0, app_name: CANalyzer, bitrate: 1000000}",
        "{interface: socketcand, channel: can0, host: localhost, port: 29536}",
        "{interface: udp_multicast, channel: 239.74.163.2, hop_limit: 1}",
    ],
)
def test_what_may_be(bus: str, tmp_path: Path, checked: Callable[..., str]) -> None:
    folder = tmp_path / "new" / "state"
    text = f"bus: {bus}\n{MODULES}    state_dir: {folder}\n  - node_id: 127\nrealtime: {{cpu: 0}}\n"
    assert checked(text, 0) == ": valid; modules: 20h, 7Fh"
    assert not folder.exists()


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_that_may_not_be_written_to(tmp_path: Path, checked: Callable[..., str]) -> None:
    tmp_path.joinpath("closed").mkdir(mode=0o500)
    assert checked(f"{MODULES}    state_dir: {tmp_path}/closed/x\n").endswith("closed is not writable")


@pytest.mark.parametrize("interface", sorted(can.VALID_INTERFACES))
def test_every_interface_knows_its_keys_without_its_driver(interface: str) -> None:
    check_words({"interface": interface, "channel": "x", "bitrate": 1000000})
    with pytest.raises(ConfigError, match="unknown key 'no_such_key' in bus"):
        check_words({"interface": interface, "no_such_key": 1})
