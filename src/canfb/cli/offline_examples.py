"""The examples of the commands that need no node: plans, logs, configurations."""

from __future__ import annotations

OFFLINE = {
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
