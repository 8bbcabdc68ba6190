"""All commands: each module adds its own to the command line (``register``)."""

from __future__ import annotations

from canfb.cli import (
    backup_command,
    calibrate,
    config_file,
    demo,
    monitor,
    nmt_command,
    plan_command,
    run,
    sdo_command,
    simulate,
    table_command,
)

COMMANDS = (
    demo,
    plan_command,
    run,
    monitor,
    simulate,
    nmt_command,
    sdo_command,
    calibrate,
    table_command,
    backup_command,
    config_file,
)
