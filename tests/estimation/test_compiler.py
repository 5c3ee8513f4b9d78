"""How kernels are compiled: with a cache or without one, and to sums that are rounded alike everywhere."""

import importlib.util
import logging
import re

import numpy as np
import pytest
from numba.core import caching, event

from bodylog.estimation.inference.compiler import (
    CompilationNotice,
    declare_kernel,
    input_array,
    number,
    output_array,
)

KERNEL = """
from bodylog.estimation.inference.compiler import compile_inner, declare_kernel, input_array, number, output_array

@compile_inner
def multiply_and_add(a, factor, found):
    for i in range(len(a)):
        found[i] += a[i] * factor

@declare_kernel(input_array(1), number, output_array(1))
def add_multiple(a, factor, found):
    multiply_and_add(a, factor, found)
"""


def imported(folder, name="own_kernel"):
    """A module with a kernel, as the process that starts next imports it."""
    path = folder / f"{name}.py"
    if not path.exists():
        path.write_text(KERNEL)
    spec = importlib.util.spec_from_file_location(name, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def works(kernel):
    found = np.ones(5)
    kernel(np.arange(5.0), 2.0, found)
    return np.array_equal(found, 1.0 + 2.0 * np.arange(5.0))


def notices(caplog, folder):
    """What is said while the module is imported."""
    caplog.clear()
    with caplog.at_level(logging.WARNING), event.install_listener("numba:compile", CompilationNotice()):
        assert works(imported(folder).add_multiple.compiled)
    return [record.getMessage() for record in caplog.records]


def test_compiling_is_said_once_and_taking_from_the_cache_is_not(tmp_path, caplog):
    (said,) = notices(caplog, tmp_path)
    assert said.startswith("bodylog compiles its filter")
    assert not notices(caplog, tmp_path)


def test_a_changed_file_is_compiled_again(tmp_path, caplog):
    notices(caplog, tmp_path)
    (tmp_path / "own_kernel.py").write_text(f"{KERNEL}\n# changed\n")
    assert notices(caplog, tmp_path)


def test_without_a_folder_that_can_be_written_each_start_compiles(tmp_path, caplog, monkeypatch):
    monkeypatch.setattr(caching.CacheImpl, "_locator_classes", [])
    assert notices(caplog, tmp_path) and notices(caplog, tmp_path)


def test_a_disk_that_is_full_is_no_error(tmp_path, caplog, monkeypatch):
    def fail(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(caching.IndexDataCacheFile, "save", fail)
    assert notices(caplog, tmp_path)


@pytest.mark.parametrize("content", [b"", b"not a pickle"])
def test_a_broken_cache_is_no_error(tmp_path, caplog, content):
    notices(caplog, tmp_path)
    for path in tmp_path.rglob("*.nb[ic]"):
        path.write_bytes(content)
    assert notices(caplog, tmp_path)


def test_products_are_not_fused_with_sums(tmp_path):
    (text,) = imported(tmp_path).add_multiple.compiled.inspect_asm().values()
    assert re.search(r"mul", text) and not re.search(r"fn?m(add|sub|la|ls)", text)


def test_a_kernel_takes_its_own_types_alone():
    @declare_kernel(input_array(1), number, output_array(1))
    def fill(a, factor, found):
        found[0] = a[0] * factor

    with pytest.raises(TypeError, match="No matching definition"):
        fill.compiled(np.zeros(1, np.float32), 1.0, np.zeros(1))


def test_a_quiet_command_silences_its_own_run_alone(run_cli, tmp_path):
    before = logging.getLogger("bodylog").level
    assert run_cli("info", "-q", tmp_path / "absent.bag")
    assert logging.getLogger("bodylog").level == before
