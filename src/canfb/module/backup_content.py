"""Between the configuration of a module and the values that a backup holds."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from canfb import objects as od
from canfb.device.od.dcf import Place
from canfb.device.od.dictionary import Dictionary
from canfb.eds_files import eds_path
from canfb.module.delivered import EDS
from canfb.module.device_configuration import DeviceConfiguration, configuration_read

OF_THE_MACHINE = (od.PRESET_VALUE, od.HIGH_PRECISION_PRESET, od.OFFSET_VALUE)
"""What `save` keeps as well, and no master can write back: a preset needs a valid position at standstill."""
_CAN_ID = 0x1FFFFFFF


def backup_values(configuration: DeviceConfiguration) -> dict[Place, Any]:
    """The parameters of a module, without the table."""
    return {setting.place: setting.value for setting in configuration.settings}


def restored_configuration(
    values: Mapping[Place, Any], before: Mapping[Place, Any], table: bytes, made_for: int, node_id: int
) -> DeviceConfiguration:
    """What the node `node_id` is to be, of the `values` of a backup `made_for` a node-ID, both 1..127.

    What the backup does not have stays as `before`. A COB-ID that has its default follows the node-ID.
    """
    merged = dict(before) | moved_values(values, made_for, node_id)
    serial = 0  # not written by SDO
    return configuration_read(node_id, lambda entry: merged[entry.index, entry.subindex], serial, table)


def moved_values(values: Mapping[Place, Any], old: int, new: int) -> dict[Place, Any]:
    """The values of node `old` as those of node `new`: CAN-IDs that are the default of `old` follow it."""
    if old == new:
        return dict(values)
    dictionary = Dictionary.load(eds_path(EDS), old)
    moved = dict(values)
    for place, value in values.items():
        entry = dictionary.find(*place)
        if entry is not None and entry.follows_node_id and not (value ^ entry.default) & _CAN_ID:
            moved[place] = value + new - old
    return moved
