"""DCF and concise DCF as the programs of others read them: python canopen, dcfchk and its library."""

from __future__ import annotations

import struct
import subprocess
import sys
from pathlib import Path
from typing import Any

import canopen
import dcf
import pytest
from configuration_kit import NODE_ID, played, run, state, table, write
from hypothesis import given
from hypothesis import strategies as st
from module_bench import Bench

from canfb.device.od.dcf import Commissioning, FileInfo, Reals, dcf_text, real_as_text
from canfb.device.od.writes import Write, encode_concise
from canfb.eds_files import eds_path
from canfb.module.device_configuration import DeviceConfiguration, configuration_of
from canfb.module.feedback_module import FeedbackModule
from canfb.module.module_config import ModuleConfig, SecondPositionConfig
from canfb.signal.conditioning import Conditioning
from drawing import examples

TABLE = table(256, 0.015)
WITH_TABLE = [Write(0x2020, 1, TABLE.to_bytes()), write(0x2020, 3, 4, TABLE.crc32)]
OTHER_PDOS = [
    write(0x1802, 1, 4, 0x800003A0),
    write(0x1A02, 1, 4, 0x20110740),  # 64 bits of a REAL32: refused
    write(0x1A02, 1, 4, 0x20110720),
    write(0x1A02, 2, 4, 0x20110510),
    write(0x1A02, 0, 1, 2),
    write(0x1802, 2, 1, 254),
    write(0x1802, 3, 2, 15),
    write(0x1802, 5, 2, 100),
    write(0x1802, 1, 4, 0x400003A0),
    write(0x1401, 1, 4, 0x80000310),
    write(0x1601, 1, 4, 0x20000310),
    write(0x1601, 2, 4, 0x00050008),  # a gap
    write(0x1601, 0, 1, 2),
    write(0x1401, 2, 1, 1),
    write(0x1401, 1, 4, 0x310),
]
APPLICATION = [
    write(0x1017, 0, 2, 500),
    write(0x1016, 1, 4, 0x0005_0064),
    write(0x1029, 1, 1, 2),
    write(0x6000, 0, 2, 4),
    write(0x6001, 0, 4, 3600),
    write(0x6301, 1, 1, 0x0F),
    write(0x6310, 1, 4, (1 << 32) - 200),  # -200
    write(0x6330, 1, 2, 25),
]
CONDITIONING = Conditioning(12.5, -3.25, 1.0371, 0.93, -0.0213)
SOURCES: dict[str, tuple[dict[str, Any], list[Write]]] = {
    "as delivered": ({}, []),
    "16 bits": ({"adc_bits": 16, "cycles_per_revolution": 1024, "encoder_interface": 0x11}, []),
    "conditioning": ({"conditioning": CONDITIONING, "max_acceleration_rad_s2": 1234.567}, []),
    "a second position": (
        {"second_position": SecondPositionConfig(tolerance_revolutions=0.01, cob_id=0x1B0)},
        [],
    ),
    "table": ({"conditioning": CONDITIONING, "adc_bits": 14}, WITH_TABLE),
    "not valid": ({}, [write(0x1801, 2, 1, 0xFC), write(0x1801, 1, 4, 0xC0000500)]),
    "PDOs": ({"coast_samples": 11, "autostart": True}, OTHER_PDOS),
    "all": ({"adc_bits": 16, "conditioning": CONDITIONING}, [*OTHER_PDOS, *APPLICATION, *WITH_TABLE]),
}


def source(name: str) -> FeedbackModule:
    fields, program = SOURCES[name]
    module = FeedbackModule(ModuleConfig(node_id=NODE_ID, **fields))
    module.start(0.0)
    run(module, program)
    return module


def text_of(configuration: DeviceConfiguration, reals: Reals = Reals.DECIMAL) -> str:
    info = FileInfo(file_name="module.dcf", description="A module", date="11-21-2026", time="08:00AM")
    place = Commissioning(
        node_id=configuration.node_id,
        node_name="module_20h",
        bit_rate_kbit_s=500,
        network_name="CANopen",
        serial_number=configuration.serial_number,
    )
    return dcf_text(eds_path("canfb-module"), info, place, configuration.values(), reals=reals)


def write_dcf(
    folder: Path, configuration: DeviceConfiguration, reals: Reals = Reals.DECIMAL, name: str = "module.dcf"
) -> Path:
    path = folder / name
    path.write_bytes(text_of(configuration, reals).encode("ascii"))
    return path


def loaded_by_canopen(path: Path) -> Bench:
    """A module as delivered, and python canopen's master, which has loaded the DCF into it."""
    bench = Bench()
    remote = canopen.RemoteNode(NODE_ID, canopen.import_od(str(path)))
    bench.network.add_node(remote)
    remote.load_configuration()
    return bench


@pytest.mark.parametrize("name", SOURCES)
def test_python_canopen_makes_a_module_as_delivered_the_same(name: str, tmp_path: Path) -> None:
    wanted = source(name)
    bench = loaded_by_canopen(write_dcf(tmp_path, configuration_of(wanted)))
    assert state(bench.module) == state(wanted)
    assert configuration_of(bench.module).writes() == configuration_of(wanted).writes()
    frames = played(wanted)
    assert played(bench.module) == frames
    assert len(frames) > 30


def test_python_canopen_knows_node_and_bit_rate(tmp_path: Path) -> None:
    od: Any = canopen.import_od(str(write_dcf(tmp_path, configuration_of(source("all")))))
    assert (od.node_id, od.bitrate) == (NODE_ID, 500_000)
    assert od[0x1800][1].value == 0x400001A0
    assert od[0x2020][1].value == TABLE.to_bytes()
    assert od[0x6003].value is None


def dcfchk(path: Path) -> tuple[int, str]:
    """Exit code and words of dcfchk with the node-ID."""
    code = "import sys; from dcf.cli import main; sys.exit(main())"
    done = subprocess.run(
        [sys.executable, "-W", "always", "-c", code, "-n", str(NODE_ID), str(path)],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    return done.returncode, done.stdout + done.stderr


@pytest.mark.parametrize(("name", "reals"), [
    ("as delivered", Reals.DECIMAL), ("16 bits", Reals.DECIMAL), ("PDOs", Reals.DECIMAL),
    *((name, Reals.IEEE754) for name in SOURCES),
])  # fmt: skip
def test_dcfchk_accepts_it(name: str, reals: Reals, tmp_path: Path) -> None:
    assert dcfchk(write_dcf(tmp_path, configuration_of(source(name)), reals)) == (0, "")


def test_dcfchk_takes_bits_for_a_real32_and_no_decimal_fraction(tmp_path: Path) -> None:
    """Why there are two ways to write them."""
    code, words = dcfchk(write_dcf(tmp_path, configuration_of(source("conditioning"))))
    assert code == 1
    assert "invalid ParameterValue in [2002sub1]: 12.5" in words


@pytest.mark.parametrize("name", SOURCES)
def test_the_concise_form_is_what_dcf_tools_make_of_the_values(name: str, tmp_path: Path) -> None:
    """Each write that sets an object for good, byte for byte.

    dcfgen itself takes ParameterValue for what the device holds already, and writes none of them.
    """
    configuration = configuration_of(source(name))
    device = dcf.Device.from_dcf(str(write_dcf(tmp_path, configuration, Reals.IEEE754)), {"NODEID": NODE_ID})
    final = {(one.index, one.subindex): one for one in configuration.writes()}
    assert set(final) == set(configuration.values())
    for place, one in final.items():
        object_ = device[place[0]][place[1]]
        if object_.data_type.index == 0x0F:
            assert object_.parse_value() == one.data
        else:
            packed = object_.data_type.concise_value(*place, object_.parse_value())
            assert encode_concise([one])[4:] == packed, place


@given(st.floats(width=32, allow_nan=False, allow_infinity=False))
@examples(200)
def test_every_real32_comes_back_from_both_ways(value: float) -> None:
    data = struct.pack("<f", value)
    assert struct.pack("<f", float(real_as_text(8, value, Reals.DECIMAL))) == data
    assert struct.pack("<I", int(real_as_text(8, value, Reals.IEEE754), 0)) == data
