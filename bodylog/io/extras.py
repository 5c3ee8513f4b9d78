"""Packages of the extras, imported on first use."""

import sys
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

from ..errors import UsageError

_NEEDS: Mapping[str, tuple[str, str]] = {
    "av": ("datasets", "videos need PyAV"),
    "dask": ("dask", "--scheduler needs Dask"),
    "distributed": ("dask", "--scheduler needs Dask"),
    "fsspec": ("cloud", "a URL as a log needs fsspec"),
    "h5py": ("datasets", "HDF5 episodes need h5py"),
    "matplotlib": ("report", "figures need matplotlib"),
    "pandas": ("pandas", "a DataFrame needs pandas"),
    "pyarrow": ("datasets", "Parquet tables need pyarrow"),
    "pybullet": ("sim", "the simulated arm needs PyBullet"),
    "rerun": ("view", "the viewer needs rerun-sdk"),
    "rerun_cli": ("view", "the viewer needs rerun-sdk"),
}
"""The extra of each package, and what needs it."""


def require_module(module: str, path: Path | None = None) -> Any:
    """Import a module of an extra; UsageError names the
    file that needs it, if any, and the extra to install.
    """
    try:
        return import_module(module)
    except ImportError:
        where = "" if path is None else f"{path}: "
        raise UsageError(f"{where}{describe_missing(module)}") from None


def describe_missing(module: str) -> str:
    """What needs a module, and what to type for it."""
    extra, need = _NEEDS[module.partition(".")[0]]
    compiled = module == "pybullet" and sys.version_info >= (3, 12)
    advice = " (it is compiled here: a C++ compiler and about 5 minutes)" if compiled else ""
    return f"{need}; type: pip install 'bodylog[{extra}]'{advice}"
