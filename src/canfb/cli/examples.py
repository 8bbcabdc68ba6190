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
  canfb try --rate 500 --no-scope
  canfb try --json --ready-file try.ready""",
    "canfb run": """
  canfb run feedback.yaml
  canfb run feedback.yaml -i socketcan -c can0
  canfb run feedback.yaml -i udp_multicast -c 239.74.163.2""",
    "canfb interface": """
  canfb interface interface.yaml
  canfb interface interface.yaml -i socketcan -c can0 --ready-file interface.ready""",
    "canfb monitor": """
  canfb monitor -i socketcan -c can0
  canfb monitor 0x20 0x21 -i socketcan -c can0 -b 500000 --sdo
  canfb monitor --config feedback.yaml --per-revolution '5 mm'
  canfb monitor --log drive.asc --json""",
    "canfb dump": """
  canfb dump --config feedback.yaml
  canfb dump 0x20 -i socketcan -c can0 --pdo --seconds 1
  canfb dump 0x20 --log drive.asc --json""",
    "canfb simulate": """
  canfb simulate feedback.yaml --rate 100
  canfb simulate feedback.yaml --rate 500 --rpm 300 --module 0x20
  canfb simulate feedback.yaml --rate 500 --samples tracks.csv --columns b,a --mid-scale 8192""",
    "canfb why": """
  canfb why 0x20 -i socketcan -c can0
  canfb why 0x20 --config feedback.yaml --json""",
    "canfb diagnose": """
  canfb diagnose feedback.yaml
  canfb diagnose 0x10 0x20 -i socketcan -c can0 --out machine.json""",
    "canfb reset": """
  canfb reset 0x20 -i socketcan -c can0
  canfb reset 0x20 --config feedback.yaml --force""",
    "canfb bus scan": """
  canfb bus scan -i socketcan -c can0
  canfb bus scan feedback.yaml --json""",
    "canfb nmt": """
  canfb nmt start all -i socketcan -c vcan0
  canfb nmt start 0x10 0x20 --config feedback.yaml
  canfb nmt reset 0x20 --config feedback.yaml""",
    "canfb sdo read": """
  canfb sdo read 0x20 "residual limit" -i socketcan -c can0
  canfb sdo read 0x20 supervision --config feedback.yaml
  canfb sdo read 0x20 2011:01 --json --config feedback.yaml""",
    "canfb sdo write": """
  canfb sdo write 0x20 "samples to coast" 4 --config feedback.yaml
  canfb sdo write 0x20 1010:01 save --config feedback.yaml
  canfb sdo write 5 6083 1000 --eds drive.eds --config feedback.yaml""",
    "canfb scope": """
  canfb scope --demo
  canfb scope -i socketcan -c can0 -b 1000000
  canfb scope --config feedback.yaml --sdo""",
    "canfb calibrate": """
  canfb calibrate -i socketcan -c can0 --module 0x20 --out measured
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
    "canfb table upload": """
  canfb table upload 0x20 measured/table.yaml --config feedback.yaml
  canfb table upload 0x20 measured/table.yaml --activate --save --config feedback.yaml""",
    "canfb table download": """
  canfb table download 0x20 table.yaml --config feedback.yaml""",
    "canfb table activate": """
  canfb table activate 0x20 --save --config feedback.yaml""",
    "canfb table clear": """
  canfb table clear 0x20 --config feedback.yaml""",
    "canfb backup": """
  canfb backup 0x20 left-drive.yaml --config feedback.yaml""",
    "canfb restore": """
  canfb restore left-drive.yaml --dry-run --config feedback.yaml
  canfb restore left-drive.yaml --preop --save --config feedback.yaml""",
    "canfb demo": """
  canfb demo
  canfb demo --json
  canfb demo --out pictures""",
    "canfb plan": """
  canfb plan feedback.yaml
  canfb plan feedback.yaml --rate 2000 --rpm 3000 --acceleration 500 --times
  canfb plan -b 500000 --rate 1000 --jitter 20 --rpm 1500 --acceleration 120 --modules 4 --json""",
    "canfb record": """
  canfb record bus.log -i socketcan -c can0
  canfb record bus.blf --config feedback.yaml --seconds 60
  canfb record week.log --config feedback.yaml --max-size 100M""",
    "canfb replay": """
  canfb replay bus.log --config feedback.yaml --report replay.html
  canfb replay bus.blf --config feedback.yaml --table new.yaml --set coast_samples=5
  canfb replay bus.log --module 0x20 --encoder-interface 0x10 --out samples.parquet
  canfb replay month --config feedback.yaml --out month.parquet --workers 4""",
    "canfb config": """
  canfb config example > feedback.yaml
  canfb config check feedback.yaml
  canfb config dcf feedback.yaml""",
    "canfb config check": """
  canfb config check feedback.yaml""",
    "canfb config example": """
  canfb config example > feedback.yaml""",
    "canfb config dcf": """
  canfb config dcf feedback.yaml --module 0x20 --out left.dcf --concise left.bin
  canfb config dcf --node 0x20 -i socketcan -c can0""",
}


def examples_of(command: str) -> str | None:
    """The examples of a command, ``canfb run``; None where there are none."""
    lines = _EXAMPLES.get(command)
    return None if lines is None else f"examples:{lines}"
