"""Packages of the extra `datasets`, imported on first use."""

from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

from ...errors import UsageError

_PACKAGES: Mapping[str, tuple[str, Callable[[], Any]]] = {
    "pyarrow": ("LeRobot tables need pyarrow", lambda: import_module("pyarrow")),
    "pyarrow.parquet": ("LeRobot tables need pyarrow", lambda: import_module("pyarrow.parquet")),
    "h5py": ("HDF5 episodes need h5py", lambda: import_module("h5py")),
    "av": ("videos need PyAV", lambda: import_module("av")),
}


def require_module(module: str, path: Path) -> Any:
    """Import a module of the extra; UsageError names the package to install."""
    why, imported = _PACKAGES[module]
    try:
        return imported()
    except ImportError:
        raise UsageError(f'{path}: {why}; type: pip install "bodylog[datasets]"') from None
