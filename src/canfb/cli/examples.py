"""The examples at the end of each ``--help``."""

from __future__ import annotations

_EXAMPLES = {
    "canfb": """
  canfb demo                                   a complete demonstration, without a bus
  canfb try                                    a module to look at and to talk to, without hardware
  canfb config example > feedback.yaml         a configuration to start from
  canfb run feedback.yaml                      run its module on its bus
  canfb simulate feedback.yaml --rate 100      simulate encoder interface and machine, produce SYNC""",
    "canfb try": """
  canfb try
  canfb try --story --out pictures             (or: canfb demo)
  canfb try --rate 500 --no-page
  canfb try --json --ready-file try.ready""",
    "canfb run": """
  canfb run feedback.yaml
  canfb run feedback.yaml -i socketcan -c can0
  canfb run interface.yaml -i udp_multicast -c 239.74.163.2 --ready-file interface.ready""",
    "canfb monitor": """
  canfb monitor -i socketcan -c can0
  canfb monitor 0x20 0x21 -i socketcan -c can0 -b 500000 --sdo
  canfb monitor --config feedback.yaml --per-revolution '5 mm'
  canfb monitor --log drive.asc --json
  canfb monitor 0x20 --frames -i socketcan -c can0 --pdo --seconds 1
  canfb monitor --web feedback.yaml --sdo""",
    "canfb simulate": """
  canfb simulate feedback.yaml --rate 100
  canfb simulate feedback.yaml 0x20 --rate 500 --rpm 300
  canfb simulate feedback.yaml --rate 500 --samples tracks.csv --columns b,a --mid-scale 8192""",
    "canfb why": """
  canfb why 0x20 -i socketcan -c can0
  canfb why 0x20 --config feedback.yaml --json
  canfb why --status 0x0006
  canfb why feedback.yaml --bundle --out machine.json""",
    "canfb node reset": """
  canfb node reset 0x20 -i socketcan -c can0
  canfb node reset all --config feedback.yaml""",
    "canfb node list": """
  canfb node list -i socketcan -c can0
  canfb node list --config feedback.yaml --json""",
    "canfb node start": """
  canfb node start all -i socketcan -c vcan0
  canfb node start 0x10 0x20 --config feedback.yaml""",
    "canfb sdo read": """
  canfb sdo read 0x20 "residual limit" -i socketcan -c can0
  canfb sdo read 0x20 supervision --config feedback.yaml
  canfb sdo read 0x20 2011:01 --json --config feedback.yaml""",
    "canfb sdo write": """
  canfb sdo write 0x20 "samples to coast" 4 --config feedback.yaml
  canfb sdo write 0x20 1010:01 save --config feedback.yaml
  canfb sdo write 5 6083 1000 --eds drive.eds --config feedback.yaml""",
    "canfb calibrate": """
  canfb calibrate 0x20 -i socketcan -c can0 --out measured
  canfb calibrate feedback.yaml --save
  canfb calibrate feedback.yaml --dry-run --json
  canfb calibrate feedback.yaml --check
  canfb calibrate feedback.yaml --speeds 61,1500,3000 --out measured
  canfb calibrate --samples measured/samples.npz --out again""",
    "canfb commission": """
  canfb commission 0x20 -i socketcan -c can0 --out limits
  canfb commission feedback.yaml --seconds 120 --acceleration 400
  canfb commission feedback.yaml --write --save""",
    "canfb table show": """
  canfb table show 0x20 -i socketcan -c can0
  canfb table show measured/table.yaml""",
    "canfb table write": """
  canfb table write 0x20 measured/table.yaml --config feedback.yaml
  canfb table write 0x20 measured/table.yaml --activate --save --config feedback.yaml""",
    "canfb table read": """
  canfb table read 0x20 table.yaml --config feedback.yaml""",
    "canfb table activate": """
  canfb table activate 0x20 --save --config feedback.yaml""",
    "canfb table clear": """
  canfb table clear 0x20 --config feedback.yaml""",
    "canfb backup save": """
  canfb backup save 0x20 left-drive.yaml --config feedback.yaml""",
    "canfb backup restore": """
  canfb backup restore left-drive.yaml --dry-run --config feedback.yaml
  canfb backup restore left-drive.yaml --preop --save --config feedback.yaml""",
    "canfb plan": """
  canfb plan feedback.yaml
  canfb plan feedback.yaml --rate 2000 --rpm 3000 --acceleration 500 --times
  canfb plan -b 500000 --rate 1000 --jitter 20us --rpm 1500 --acceleration 120 --modules 4 --json""",
    "canfb log record": """
  canfb log record bus.log -i socketcan -c can0
  canfb log record bus.blf --config feedback.yaml --seconds 60
  canfb log record week.log --config feedback.yaml --max-size 100M""",
    "canfb log replay": """
  canfb log replay bus.log --config feedback.yaml --report replay.html
  canfb log replay bus.blf --config feedback.yaml --table new.yaml --set coast_samples=5
  canfb log replay bus.log 0x20 --encoder-interface 0x10 --out samples.parquet
  canfb log replay month --config feedback.yaml --out month.parquet --workers 4""",
    "canfb use": """
  canfb use -i socketcan -c can0
  canfb use
  canfb use --forget""",
    "canfb config": """
  canfb config example > feedback.yaml
  canfb config check feedback.yaml
  canfb config dcf feedback.yaml""",
    "canfb config check": """
  canfb config check feedback.yaml""",
    "canfb config example": """
  canfb config example > feedback.yaml""",
    "canfb config dcf": """
  canfb config dcf feedback.yaml 0x20 --out left.dcf --concise left.bin
  canfb config dcf 0x20 -i socketcan -c can0""",
}


def examples_of(command: str) -> str | None:
    lines = _EXAMPLES.get(command)
    return None if lines is None else f"examples:{lines}"
