"""Reading what a module has saved, beside the module that runs on it."""

from __future__ import annotations

import errno
from collections.abc import Mapping
from pathlib import Path

import pytest

from canfb.device.storage.image import ParameterGroup
from canfb.hosting import state_files
from canfb.hosting.state_files import SavedParameters, StateFiles

IMAGES: dict[ParameterGroup, bytes | None] = {
    ParameterGroup.COMMUNICATION: b"one",
    ParameterGroup.MANUFACTURER: b"two",
}


def test_it_reads_beside_the_process_that_has_the_folder(tmp_path: Path) -> None:
    with StateFiles(tmp_path / "state") as owner:
        owner.save(IMAGES)
        assert SavedParameters(tmp_path / "state").load() == IMAGES


def test_a_folder_that_is_not_there_is_not_made(tmp_path: Path) -> None:
    assert SavedParameters(tmp_path / "nothing").load() == {}
    assert list(tmp_path.iterdir()) == []


def test_nothing_is_saved(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="for reading only") as error:
        SavedParameters(tmp_path).save(IMAGES)
    assert error.value.errno == errno.EROFS
    assert list(tmp_path.iterdir()) == []


def test_a_save_between_two_readings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Half of the old set and half of the new one are not what is kept."""
    old, new = dict.fromkeys(IMAGES, b"old"), dict.fromkeys(IMAGES, b"new")
    mixed = old | {ParameterGroup.MANUFACTURER: b"new"}
    readings = iter([mixed, new, new])

    def load(self: StateFiles) -> Mapping[ParameterGroup, bytes]:
        return next(readings)

    monkeypatch.setattr(state_files.StateFiles, "load", load)
    assert SavedParameters(tmp_path).load() == new


def test_a_file_that_cannot_be_read_is_told(tmp_path: Path) -> None:
    (tmp_path / "manufacturer.bin").mkdir()
    found = SavedParameters(tmp_path).load()
    assert isinstance(found[ParameterGroup.MANUFACTURER], OSError)
