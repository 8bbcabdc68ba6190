"""A backup, restored into a module of the bench and kept, as `canfb backup restore --save` does it."""

from __future__ import annotations

from canfb.master.access import NodeAccess
from canfb.master.all_or_nothing import Guard
from canfb.module.device_configuration import read_configuration, restored_configuration
from canfb.sdo.backup_file import Backup
from canfb.sdo.backup_tasks import Restored, RestoreOptions, Restoring
from commissioning_kit import MODULE_ID, Bench


def restore_from(kept: Backup, bench: Bench) -> Restored:
    """The account of a restore that has succeeded."""
    read = lambda: read_configuration(NodeAccess(bench.master, MODULE_ID, "module"))  # noqa: E731
    return Restoring(bench.access, read, Guard()).restore(
        kept,
        lambda before: restored_configuration(kept.values, before, kept.table, MODULE_ID, MODULE_ID),
        RestoreOptions(keep=True),
    )
