"""A module killed at every system call of a save, and that the tool would see a store that is not safe."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
IN_PLACE = """
import os, sys
from canfb.hosting.state_files import StateFiles
from tools.faults.saving import kills

def write(self, name, data):
    with open(self.folder / name, "wb", buffering=0) as file:
        file.write(data[:100])
        file.write(data[100:])

StateFiles._write = write
kills.COMMANDS = kills.COMMANDS[:1]
sys.exit(kills.main(["--every", "2000", "--json"]))
"""


def run(*arguments: str) -> tuple[int, dict[str, Any]]:
    """Exit status and what it says; skips where no process may be traced."""
    done = subprocess.run(
        [sys.executable, "-W", "error", *arguments],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
        cwd=ROOT,
        env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
    )
    if done.returncode == 2:
        pytest.skip(done.stderr)
    assert done.stderr == ""
    return done.returncode, json.loads(done.stdout)


def test_the_old_or_the_new_set_is_there_after_every_kill_and_damage_is_refused() -> None:
    status, told = run("-m", "tools.faults.saving.kills", "--every", "53", "--json")
    assert (status, told["good"]) == (0, True)
    for one in told["kills"]:
        assert one["neither"] == 0
        assert min(one["old"], one["new"]) > 5  # before and after the commit
        assert one["old"] + one["new"] == one["kills"]
    assert {one["file"] for one in told["damage"]} == {f"{name}.bin" for name in GROUPS}
    assert all(one["cuts"] >= 5 and one["flips"] >= 50 and one["accepted"] == 0 for one in told["damage"])


GROUPS = ("application", "communication", "manufacturer")


def test_a_store_that_writes_in_place_is_found_out() -> None:
    status, told = run("-c", IN_PLACE)
    assert (status, told["good"]) == (1, False)
    assert [one["neither"] > 0 for one in told["kills"]] == [True]
