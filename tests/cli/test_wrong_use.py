"""What is refused, in one line that says why: exit code 2 for wrong use, 1 for what fails."""

from pathlib import Path

import numpy as np
import pytest

from commands import Command

MODULES = "modules: [{node_id: 32}, {node_id: 33, encoder_interface: 17}]\n"
FILES = {
    "feedback.yaml": f"bus: {{interface: virtual, channel: wrong-use}}\n{MODULES}",
    "drive.yaml": f"{MODULES}simulation: {{drive: {{}}}}\n",
    "typo.yaml": f"bus: {{interface: socketcam, channel: can0}}\n{MODULES}",
    "fast.yaml": f"bus: {{bitrate: fast}}\n{MODULES}",
    "key16.yaml": "modules: [{node_id: 16, encoder_interface: 17}]\nsimulation: {sync_jitter_us: 600}\n",
    "state.yaml": "modules: [{node_id: 32, state_dir: tracks.csv}]\n",
    "bits.yaml": "modules: [{node_id: 32, source: {kind: iio, device: ads7950}}]\n",
    "unnamed.yaml": "modules: [{node_id: 255, serial_number: 7}]\n",
    "tracks.csv": "t,a,b\n0,2148,1948\n0.001,2248,1848\n0.9,2348,1748\n0.901,2448,1648\n",
    "text.npz": "sine,cosine\n1,2\n",
    "zip.npz": "PK\x03\x04 and no more",
}
ARRAYS = {
    "still.npz": {"sine": np.full(1000, 700), "cosine": np.full(1000, -1200)},
    "one.npz": {"sine": [1]},
    "lengths.npz": {"sine": [1, 2], "cosine": [1]},
    "deep.npz": {"sine": [[1]], "cosine": [[1]]},
    "other.npz": {"other": [1]},
}
NO_FILE = "cannot be read: No such file or directory"
TYPO = "unknown interface 'socketcam' in bus; did you mean 'socketcan'?"
NOT_A_NODE = "is not a node-ID (1 to 127, or 0x01 to 0x7F)"
LONG = 256 * "x"

WRONG_USE = {
    "--debug": "canfb: the following arguments are required: COMMAND; see canfb --help",
    "fly": "canfb: argument COMMAND: invalid choice: 'fly'",
    "demo --fast": "canfb: unrecognized arguments: --fast",
    "demo '--fa\nst'": "canfb: unrecognized arguments: --fa st",
    "run": "canfb run: the following arguments are required: CONFIG.yaml; see canfb run --help",
    "run x.yaml -i wires": "canfb run: argument -i/--interface: invalid choice",
    **{
        f"{one} nothing.yaml": f"canfb: nothing.yaml: {NO_FILE}"
        for one in ("run", "simulate", "calibrate", "commission", "plan", "config dcf")
    },
    **dict.fromkeys(("run typo.yaml", "simulate typo.yaml", "calibrate typo.yaml"), TYPO),
    "config": "canfb config: the following arguments are required: PART",
    "config check typo.yaml": f"canfb: typo.yaml:1: {TYPO}",
    "try --story --rate 200": "--rate: not with --story",
    "try --out x": "--out: only with --story",
    **{f"try --rate {rate}": f"--rate {rate}" for rate in ("20", "2000", "nan")},
    "try --port 70000": "--port 70000",
    "try --write-config feedback.yaml": "--write-config feedback.yaml: is a configuration, and would be",
    "simulate": "CONFIG.yaml is required: its module and its simulation",
    "simulate x.yaml --rate fast": "canfb simulate: argument --rate: invalid float value",
    **{
        f"simulate feedback.yaml --rate {rate}": f"--rate {rate}: must be 0.1 to 100000 Hz"
        for rate in ("0", "-5", "0.09", "100001", "nan", "inf")
    },
    **{
        f"simulate feedback.yaml {node}": f"{int(node, 0)}: no module has this node-ID; there are 32 (20h)"
        for node in ("1", "0x22")
    },
    **{
        f"simulate feedback.yaml --rpm={rpm}": f"--rpm {float(rpm):g}: rpm must be a number "
        for rpm in ("1e9", "-1e9", "nan")
    },
    **{f"simulate feedback.yaml --{x} 5": f"--{x}: only with --samples" for x in ("columns", "mid-scale")},
    "simulate feedback.yaml --time-column t": "--time-column: only with --samples",
    "simulate feedback.yaml --samples x.csv --gap 5": "--gap: only with --time-column",
    "simulate feedback.yaml --samples x.csv --gap-samples 5": "--gap-samples: only with --time-column",
    "simulate feedback.yaml --samples x.csv --rpm 5": "--rpm: not with --samples",
    "simulate feedback.yaml --samples x.npz --columns a,b": "--columns: only for CSV",
    "simulate feedback.yaml --samples x.NPZ --time-column t": "--time-column: only for CSV",
    "simulate feedback.yaml --samples x.csv --columns a": "--columns a: two columns are required",
    "simulate feedback.yaml --samples x.csv --columns a,b,c": "--columns a,b,c: two columns are required",
    "simulate feedback.yaml --samples x.csv --mid-scale nan": "--mid-scale nan: must be a number",
    "simulate feedback.yaml --samples x.csv --time-column t --gap-samples 0": "--gap-samples 0: must be 1",
    **{f"simulate feedback.yaml --seconds={s}": "argument --seconds: " for s in ("0", "-1", "nan", "inf")},
    "simulate feedback.yaml --samples tracks.csv --record tracks.csv": "is the recording that is played",
    **{f"simulate feedback.yaml --record {x}": "must end with .csv or .npz" for x in ("x.txt", "''")},
    "simulate feedback.yaml --record no/folder/x.csv": "there is no folder",
    "simulate feedback.yaml --jitter 1ms": "--jitter: only with --rate",
    "simulate feedback.yaml --rate 100 --jitter 46%": "at most 45% (4500us)",
    "plan --jitter 2s": "--jitter must be a number 0..1e+06, not 2000000.0 µs",
    "simulate key16.yaml -i virtual --rate 1000": "sync_jitter_us: is 60% of the period; at most 45% (450us)",
    "simulate feedback.yaml --rate 100 --jitter 0.1": "is 1000% of the period",
    "simulate drive.yaml -i virtual --samples x.csv": "--samples: the drive of the configuration moves",
    "simulate drive.yaml -i virtual --rpm 5": "--rpm: the drive of the configuration moves",
    "calibrate --seconds 0": "canfb: --seconds 0: must be 0.1 to 3600",
    "calibrate --verify nan": "--verify nan: must be 0.1 to 600",
    "calibrate --entries 15": "--entries 15: must be 16 to 4096",
    "calibrate 0x10 --encoder-interface 16": "--encoder-interface 16: must differ from the node-ID",
    "calibrate --table x.yaml": "--table: only with --samples; over the bus the table is read",
    **{
        f"calibrate --source module --{more}": "--source module: it supports --method motion, --cond"
        for more in ("method zero-crossings", "conditioning none", "entries 256")
    },
    "calibrate --samples x.csv --columns a,a": "--columns a,a: two columns are required: sine,cosine",
    "calibrate --samples x.csv --columns a": "--columns a: two columns are required: sine,cosine",
    "calibrate --samples x.npz -c can0": "--channel: not with --samples",
    "calibrate --samples x.npz 3": "NODE: not with --samples",
    "calibrate --samples x.npz --dry-run": "--dry-run: not with --samples",
    "calibrate --samples x.npz --seconds 3": "--seconds: not with --samples",
    "calibrate feedback.yaml --samples x.npz": "CONFIG.yaml: not with --samples",
    "calibrate --samples x.npz --columns a,b": "--columns: only for CSV",
    "calibrate --columns a,b": "--columns: only with --samples",
    "calibrate --cycles-per-revolution 5": "--cycles-per-revolution: only with --samples",
    **{f"calibrate --check --{one}": f"--{one}: not with --check" for one in ("save", "dry-run")},
    "calibrate --dry-run --save": "--save: not with --dry-run",
    "calibrate --recorder module": "--recorder: only with --source recording",
    **{
        f"calibrate --speeds {speeds}": "two or more different speeds in rpm are required"
        for speeds in ("61", "61,fast", "61,61", "1000,1001", "0,1000", "recorded")
    },
    **{
        f"calibrate --speeds 61,1000 --{more}": f"--{more.split()[0]}: not with --speeds"
        for more in ("check", "method zero-crossings", "conditioning none", "source module")
    },
    **{f"calibrate --speeds 61,1000 --delay {s}": f"--delay {s}: seconds, at most" for s in ("long", "1")},
    **{f"calibrate --{option} 10": f"--{option}: only with --speeds" for option in ("delay", "wait")},
    "calibrate --speeds 61,1000 --wait 0": "--wait 0: must be 1 to 86400",
    "calibrate --speeds 61,1000 --samples x --wait 10": "--wait: not with --samples",
    "calibrate --speeds 61,1000 --samples x": "with --speeds a folder with a file for each speed",
    "commission 33 0x20": "32: there is another node-ID already",
    "commission a.yaml --config b.yaml": "a.yaml: there is another file already",
    "commission 0x20 --margin nan": "--margin nan: must be 1.2 to 10",
    "commission 0x20 --acceleration -1": "--acceleration -1: must be 0 to 1e+09",
    "commission 0x20 --watch 0": "--watch 0: must be 0.1 to 3600",
    "commission 0x20 --timeout 99": "--timeout 99: must be 0.01 to 60",
    "commission 0x20 --save": "--save: only with --write, without which nothing is written",
    "commission 0x20 --encoder-interface 0x20": "must differ from the node-ID of the module",
    "commission 0x20 --encoder-interface 16 --source recording": "not with --source recording",
    **{f"node reset -- {node}": NOT_A_NODE for node in ("0", "128", "-1", "x", "0x80", "ALL", "1.5")},
    "node": "required: PART",
    "node start": "required: NODE",
    "node begin all": "invalid choice: 'begin'",
    **dict.fromkeys(("node start a.yaml", "node start 1 a.yaml"), NOT_A_NODE),
    "sdo read 1 residual limit": "unrecognized arguments: limit",
    "use -i virtual --forget": "--interface: not with --forget",
    "why 5 --status 6": "NODE: not with --status",
    "why --bundle --status 6": "--bundle: not with --status",
    "why 5 --config ''": "cannot be read",
    "why 5 6": "one NODE is required, a node-ID such as 32 or 0x20; several with --bundle only",
    "table read 5 feedback.yaml": "feedback.yaml: is a configuration, and would be replaced",
    f"table read 5 {LONG}": "cannot be written: File name too long",
    "why 5 --out x.json": "--out: only with --bundle",
    "table": "the following arguments are required: PART",
    **{f"table show {x}": f"{x}: neither a node-ID (1 to 127) nor a file" for x in ("no.yaml", "128", LONG)},
    "table write 0x20 t.yaml --save": "--save: only with --activate",
    **dict.fromkeys(("table write 0 t.yaml", "config dcf 0"), f"'0' {NOT_A_NODE}; see"),
    "table clear 0x20 --timeout 0": "--timeout 0: must be 0.01 to 60",
    **{f"monitor {node}": f"'{node.split()[-1]}' {NOT_A_NODE}" for node in ("0", "128", "--web 200")},
    "monitor --log x.log -i virtual": "--interface: not with --log",
    "monitor --frames --log x.log -c can0": "--channel: not with --log",
    "monitor --updates 0 --json": "'0' is not a number above 0",
    "monitor --seconds 1e9": "'1e9' is not a number above 0 and below 1e9",
    "monitor --per-revolution 5": "'5' is not a distance per revolution",
    "monitor --frames --updates 3": "--updates: not with --frames",
    "monitor --pdo": "--pdo: only with --frames",
    "monitor --frames --web": "--frames: not with --web",
    "monitor --web --port 70000": "--port 70000: must be 0 to 65535",
    "monitor --web --port web": "invalid int value",
    "monitor --web -i nonsense": "invalid choice: 'nonsense'",
    **{
        f"monitor {web}{words}": said
        for web in ("", "--web ")
        for words, said in (
            ("--speed 2 -i virtual", "--speed: goes with --log"),
            ("32 --log x.log --sdo", "--sdo: a log answers no SDO"),
            ("--sdo -i virtual", "--sdo: name the nodes that may be asked"),
        )
    },
    "config dcf": "the following arguments are required: NODE",
    "config dcf key16.yaml --concise module-10h.dcf": "module-10h.dcf: must differ from --out",
    "config dcf 3 1": "1: there is another node-ID already",
    "config dcf x.yaml one": "'one' is not a node-ID",
    "config dcf x.yaml --timeout 2": "--timeout: only with NODE alone",
    "config dcf 3 --timeout 0": "--timeout 0: must be",
    "config dcf x.yaml --name 'a\nb'": "--name 'a\\nb': must be printable",
    **{f"config dcf x.yaml --{to} no/a": f"--{to} no/a: there is no folder no" for to in ("out", "concise")},
    "monitor -i virtual -b 0": "bitrate in bus must be bits per second, such as 1000000, not 0",
    "config dcf bits.yaml": "bits.yaml: adc_bits is required: a DCF has the full scale and the limits",
    "config dcf unnamed.yaml": "canfb: the module with serial number 7 has no node-ID yet",
    "config dcf feedback.yaml": "feedback.yaml: NODE is required, as there are several: 32 (20h), 33 (21h)",
    "config dcf feedback.yaml 1": "feedback.yaml: 1: no module has this node-ID; there are 32 (20h), 33",
    **dict.fromkeys(("log record x.log --seconds 0", "log record x.log --seconds x"), "--seconds: "),
    **{f"log record x.log --max-size {size}": "--max-size: " for size in ("-1", "9X")},
    "plan feedback.yaml --adc-bits 12": "--adc-bits: only without CONFIG.yaml",
    **{f"plan feedback.yaml --modules {n}": "--modules: only without CONFIG.yaml" for n in (1, 2)},
    **{
        f"plan --{one}": f"canfb: --{one.split()[0]} must be a number"
        for one in ("rate nan", "rate 0", "jitter 20", "extra 1.5", "rpm inf", "acceleration -3")
    },
    "plan --modules 0": "--modules must be a whole number 1..32",
    "plan --adc-bits 99": "--adc-bits must be a whole number 4..16",
    "plan --bitrate 5": "--bitrate must be a whole number 10000..1000000",
    "plan --residual-limit 0.6": "--residual-limit must be above 0 and at most 0.5",
    "plan --cycles 0": "--cycles must be a whole number",
    "plan fast.yaml": "bitrate must be a whole number",
}
PLAYED = "simulate feedback.yaml --samples"
FAILURES = {
    f"{PLAYED} tracks.csv --columns a,c": "canfb: tracks.csv:1: there is no column 'c'; there are t, a, b",
    f"{PLAYED} tracks.csv": "tracks.csv:1: there is no column 'sine'; there are t, a, b",
    f"{PLAYED} tracks.csv --columns 1,3": "tracks.csv:1: there is no column '3'; there are t, a, b",
    f"{PLAYED} tracks.csv --columns a,b --time-column s": "tracks.csv:1: there is no column 's'; there are",
    f"{PLAYED} tracks.csv --columns a,b --mid-scale 40000": "tracks.csv:2: -37852, -38052 does not fit",
    f"{PLAYED} nothing.csv": f"nothing.csv: {NO_FILE}",
    "run state.yaml -i virtual -c state": "canfb: state_dir tracks.csv cannot be used: File exists",
    **{f"calibrate --samples nothing.{kind}": f"canfb: nothing.{kind}: {NO_FILE}" for kind in ("npz", "csv")},
    **{f"calibrate --samples {x}.npz": f"{x}.npz: this is not a file of samples: " for x in ("text", "zip")},
    "calibrate --samples tracks.csv": "there is no column 'sine'; there are t, a, b",
    "calibrate --samples still.npz": "canfb: the tracks hardly change: the machine is at standstill",
    "calibrate --samples still.npz --out tracks.csv/out": "csv/out: cannot be written: Not a directory",
    **{f"calibrate --samples {name}": f"canfb: {name}: " for name in ARRAYS if name != "still.npz"},
    "calibrate -i socketcan -c nothing77": "canfb: cannot open the bus socketcan nothing77: ",
    "calibrate -i virtual -c empty --timeout 0.05": "canfb: module 32 (20h): reading 2020:04: no answer; ",
    "calibrate feedback.yaml 33 --timeout 0.05": "canfb: module 33 (21h): ",
    **{
        f"{command} unnamed.yaml -i virtual": "canfb: the module has no node-ID yet: assign one by LSS"
        for command in ("calibrate", "commission", "why")
    },
    **{
        f"{command} feedback.yaml -i {bus}": f"canfb: cannot open the bus {bus.replace(' -c', '')}: "
        for command in ("run", "simulate")
        for bus in ("socketcan -c nothing77", "udp_multicast -c 127.0.0.1")
    },
}


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wrong-use")
    for name, text in FILES.items():
        (folder / name).write_text(text)
    for name, arrays in ARRAYS.items():
        np.savez(folder / name, **arrays)  # type: ignore[arg-type]
    return folder


@pytest.mark.parametrize(
    ("line", "code", "words"),
    [(line, 2, words) for line, words in WRONG_USE.items()]
    + [(line, 1, words) for line, words in FAILURES.items()],
)
def test_one_line_says_what_is_wrong(
    line: str, code: int, words: str, files: Path, monkeypatch: pytest.MonkeyPatch, command: Command
) -> None:
    monkeypatch.chdir(files)
    out, err = command(line, code=code)
    assert out == ""
    *steps, said = err.splitlines()
    assert all(step.startswith("... ") for step in steps)
    assert words in said
    assert said.startswith(words if words.startswith("canfb") else "canfb")
