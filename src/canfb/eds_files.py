"""Where the EDS files are: the one source of every object of the devices.

They live in the folder eds/ of the repository and are part of the wheel as canfb/eds/.
"""

from pathlib import Path

from canfb.errors import CanfbError

EDS_NAMES = ("canfb-module", "encoder-interface", "drive")
_PACKAGE = Path(__file__).resolve().parent


class EdsNotFoundError(CanfbError, FileNotFoundError):
    """No such EDS file; also a FileNotFoundError."""


def eds_path(name: str) -> Path:
    """Path of the EDS file `name`, for example `canfb-module`.

    In the installed package, else in the eds/ folder of a checkout. EdsNotFoundError without such a file,
    ValueError for a `name` with folders.
    """
    if not name or Path(name).name != name:
        raise ValueError(f"name of an EDS file expected, without folders, not {name!r}")
    file_name = name if name.endswith(".eds") else f"{name}.eds"
    folders = [_PACKAGE / "eds"]
    if _PACKAGE.parent.name == "src":  # a checkout: src/canfb beside eds
        folders.append(_PACKAGE.parents[1] / "eds")
    for folder in folders:
        path = folder / file_name
        if path.is_file():
            return path
    known = sorted(path.name for folder in folders for path in folder.glob("*.eds"))
    there = f"there are {', '.join(known)}" if known else "there is none at all, so reinstall canfb"
    raise EdsNotFoundError(f"no EDS file {file_name} in {' or '.join(map(str, folders))}: {there}")
