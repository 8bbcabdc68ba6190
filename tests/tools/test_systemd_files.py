"""tools/systemd and docs/service.md: files that systemd accepts, and a page that names what is there."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from canfb.cli.command_line import FAILED
from canfb.cli.commands import WRONG_USE
from documentation import ROOT, blocks, page

FOLDER = ROOT / "tools" / "systemd"
PAGE = page("service").partition("\n## Events")[0]
UNIT = (FOLDER / "canfb@.service").read_text(encoding="utf-8")
INTERFACE = (FOLDER / "canfb-interface@.service").read_text(encoding="utf-8")
ANALYZE = shutil.which("systemd-analyze")
needs_systemd = pytest.mark.skipif(ANALYZE is None, reason="no systemd-analyze")
# systemd's own scale, 0 (best) to 100.
MOST_EXPOSED = 25


def setting(name: str, text: str = UNIT) -> str:
    (value,) = re.findall(rf"^{name}=(.*)$", text, re.MULTILINE)
    return str(value)


def analyze(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [ANALYZE or "", *arguments], capture_output=True, text=True, timeout=60, check=False
    )


def units(folder: Path, *drop_ins: str, name: str = "canfb", text: str = UNIT) -> Path:
    """The unit with a program that is there, as one file with its drop-ins."""
    path = folder / f"{name}@.service"
    path.write_text(text.replace("/opt/canfb/bin/canfb", sys.executable) + "\n" + "\n".join(drop_ins))
    return folder / f"{name}@left.service"


@needs_systemd
@pytest.mark.parametrize(("name", "text"), [("canfb", UNIT), ("canfb-interface", INTERFACE)])
def test_systemd_accepts_the_unit_and_finds_it_hardened(name: str, text: str, tmp_path: Path) -> None:
    done = analyze("verify", str(units(tmp_path, name=name, text=text)))
    assert (done.returncode, done.stderr) == (0, "")
    done = analyze(
        "security", "--offline=yes", f"--threshold={MOST_EXPOSED}", str(tmp_path / f"{name}@.service")
    )
    assert done.returncode == 0, done.stdout


@needs_systemd
def test_a_wrong_unit_is_noticed(tmp_path: Path) -> None:
    assert analyze("verify", str(units(tmp_path, "[Service]\nType=notfy\n"))).stderr != ""


@needs_systemd
def test_systemd_accepts_the_drop_ins_of_the_page(tmp_path: Path) -> None:
    drop_ins = blocks(PAGE, "ini")
    assert len(drop_ins) == 2
    done = analyze("verify", str(units(tmp_path, *drop_ins)))
    assert (done.returncode, done.stderr) == (0, "")


def test_the_unit_of_the_interface_differs_in_its_devices() -> None:
    both = [set(re.findall(r"^\w+=.*$", text, re.MULTILINE)) for text in (UNIT, INTERFACE)]
    assert sorted(both[1] - both[0]) == [
        "Description=CANopen encoder interfaces of /etc/canfb/%i.yaml",
        "DeviceAllow=char-iio rw",
        "DevicePolicy=closed",
        "SupplementaryGroups=iio",
    ]
    assert sorted(one.partition("=")[0] for one in both[0] - both[1]) == [
        "Description",
        "PrivateDevices",
        "ProtectKernelTunables",
    ]


@pytest.mark.skipif(shutil.which("udevadm") is None, reason="no udevadm")
def test_udev_accepts_the_rule() -> None:
    version = subprocess.run(["udevadm", "--version"], capture_output=True, text=True, check=True).stdout
    if int(re.findall(r"\d+", version)[0]) < 254:
        pytest.skip("udevadm verify is there from systemd 254 on")
    rule = str(FOLDER / "80-canfb-can.rules")
    done = subprocess.run(["udevadm", "verify", rule], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_unit_knows_command_and_exit_codes_waits_for_a_slow_machine_and_allows_realtime() -> None:
    assert setting("Type") == "notify"
    assert setting("ExecStart") == "/opt/canfb/bin/canfb run /etc/canfb/%i.yaml"
    assert setting("Restart") == "on-failure"
    assert (int(setting("RestartPreventExitStatus")), FAILED) == (WRONG_USE, 1)
    assert 5 <= int(setting("WatchdogSec")) <= 30
    assert "RestrictRealtime" not in UNIT
    assert setting("LimitMEMLOCK") == "infinity"
    assert {"AF_CAN", "AF_UNIX", "AF_INET"} <= set(setting("RestrictAddressFamilies").split())


def test_network_and_rule_say_the_same() -> None:
    network = (FOLDER / "80-canfb-can.network").read_text(encoding="utf-8")
    link = (FOLDER / "80-canfb-can.link").read_text(encoding="utf-8")
    rule = (FOLDER / "80-canfb-can.rules").read_text(encoding="utf-8")
    assert f'KERNEL=="{setting("Name", network)}"' in rule
    assert f'bitrate {setting("BitRate", network)}"' in rule
    assert f'restart-ms {setting("RestartSec", network).removesuffix("ms")}"' in rule
    assert f"txqueuelen {setting('TransmitQueueLength', link)} " in rule


def test_the_page_names_the_files_that_are_there() -> None:
    table = set(re.findall(r"^\| `([\w@.-]+)` \|", PAGE, re.MULTILINE))
    assert table == {file.name for file in FOLDER.iterdir()}
    installed = set(re.findall(r"tools/systemd/([\w@.-]+)", PAGE))
    assert installed == table
    assert f"/var/lib/{setting('StateDirectory').replace('%i', 'left')}" in PAGE
    assert setting("ExecStart").split()[0] in PAGE
