"""Files that stand in a folder once links are followed:
what a dataset names may be no other file of its reader.
"""

from pathlib import Path

_SNAPSHOTS = "snapshots"
_BLOBS = "blobs"


def is_inside(path: Path, folder: Path) -> bool:
    """Whether a file stands in a folder once every link is followed.

    A snapshot in Hugging Face's cache is a folder of links
    to `blobs` beside `snapshots`: these count as inside.
    """
    try:
        behind = path.resolve()
        home = folder.resolve()
    except (OSError, RuntimeError, ValueError):
        return False
    homes = [home]
    if home.parent.name == _SNAPSHOTS:
        homes.append(home.parent.parent / _BLOBS)
    return any(behind.is_relative_to(one) for one in homes)


def file_inside(folder: Path, name: str) -> Path | None:
    """The file of that name in a folder; None if it is missing, or stands outside the folder."""
    path = folder / name
    try:
        return path if path.is_file() and is_inside(path, folder) else None
    except (OSError, ValueError):
        return None
