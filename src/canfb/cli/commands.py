"""All commands: each module adds its own to the command line (``register``)."""

from __future__ import annotations

from canfb.cli import (
    backup_command,
    calibrate,
    config_file,
    demo,
    monitor,
    nmt_command,
    record,
    replay,
    run,
    sdo_command,
    simulate,
    table_command,
)

COMMANDS = (
    demo,
    run,
    monitor,
    simulate,
    nmt_command,
    sdo_command,
    calibrate,
    table_command,
    backup_command,
    record,
    replay,
    config_file,
)
