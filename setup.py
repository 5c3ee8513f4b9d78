"""Compiles the C library while setuptools builds the
package, and is the build backend that pyproject.toml names.
"""

import os
import shlex
import subprocess
import sys
from pathlib import Path
from shutil import which

from setuptools import Extension, build_meta, setup
from setuptools.build_meta import *  # noqa: F403
from setuptools.command.bdist_wheel import bdist_wheel
from setuptools.command.build_ext import build_ext

FLAGS = [
    "-O3",
    "-std=c11",
    "-fPIC",
    "-shared",
    "-ffp-contract=off",
    "-fno-math-errno",
    "-Wall",
    "-Wextra",
    "-Wno-psabi",
]
FLAGS += ["-fno-ivopts", "-Wno-ignored-optimization-argument"]
"""Without fused multiplications, so that sums are rounded alike everywhere. Square roots of vectors
need no errno. GCC's loops are 25 % faster without ivopts, which Clang does not know."""
ZIG = [sys.executable, "-m", "ziglang", "cc", "-mcpu=baseline"]
"""The compiler of a Python package. By default it compiles for the CPU that it runs on."""


def compiler():
    """$CC, or else the first compiler on the path, or else Zig's."""
    if chosen := shlex.split(os.environ.get("CC", "")):
        return chosen
    return next(([name] for name in ("cc", "gcc", "clang") if which(name)), ZIG)


def get_requires_for_build_wheel(config_settings=None):
    """What setuptools needs, and Zig's compiler where there is no other."""
    return build_meta.get_requires_for_build_wheel(config_settings) + ["ziglang"] * (
        compiler() == ZIG
    )


get_requires_for_build_editable = get_requires_for_build_wheel


class Library(build_ext):
    """Compiles all C files with one command; the library's
    name has no Python version, because it needs none.
    """

    def get_ext_filename(self, fullname):
        """The library's path below the folder of packages."""
        return f"{fullname.replace('.', os.sep)}.so"

    def build_extension(self, ext):
        """Ends with the command if it fails; the compiler says why."""
        target = Path(self.get_ext_fullpath(ext.name))
        target.parent.mkdir(parents=True, exist_ok=True)
        command = [*compiler(), *FLAGS, "-o", str(target), *ext.sources, "-lm"]
        try:
            failure = subprocess.run(command).returncode
        except OSError as err:
            failure = err.strerror
        if failure:
            advice = "install gcc or clang, type `pip install ziglang`, or name a C compiler in CC"
            raise SystemExit(
                f"error: this did not compile the C library: {shlex.join(command)} "
                f"({failure}); {advice}"
            )


class Wheel(bdist_wheel):
    """A wheel for one platform and every Python 3."""

    def get_tag(self):
        """Python, ABI, platform."""
        return "py3", "none", super().get_tag()[2]


def _library():
    sources, headers = (
        sorted(map(str, Path("bodylog/estimation").rglob(name))) for name in ("*.c", "*.h")
    )
    return Extension("bodylog.estimation.inference.libkernel", sources, depends=headers)


if __name__ == "__main__":
    setup(ext_modules=[_library()], cmdclass={"build_ext": Library, "bdist_wheel": Wheel})
