"""The compiled library: found, missing, of another version, and given arrays."""

import ctypes

import numpy as np
import pytest

from bodylog.errors import UsageError
from bodylog.estimation.inference import kernel


def test_library_loads_once():
    assert kernel.load_library() is kernel.load_library()


@pytest.mark.parametrize("content", [None, b"not a library"])
def test_missing_or_broken_library_is_one_line_with_the_command(tmp_path, monkeypatch, content):
    monkeypatch.setattr(kernel, "LIBRARY", tmp_path / "libkernel.so")
    if content:
        kernel.LIBRARY.write_bytes(content)
    with pytest.raises(UsageError, match=r"library is missing or does not load: .*libkernel\.so.*: pip install \.$"):
        kernel.load_library.__wrapped__()


class Two(ctypes.Structure):
    _fields_ = kernel.list_struct_fields("n", "", "a b")


@pytest.mark.parametrize("array", [np.zeros(3, np.float32), np.zeros(3, int), np.zeros((3, 4)).T, np.zeros(6)[::2]])
def test_arrays_of_another_type_or_order_are_not_taken(array):
    with pytest.raises(AssertionError):
        kernel.bind_kernel_call("scan", Two, n=3, a=array)


@pytest.mark.parametrize("function", ["scan", "adjoint", "evidence", "unknown"])
def test_a_library_of_another_version_is_one_line_with_the_command(function):
    with pytest.raises(UsageError, match=r"library is of another version; type in bodylog's folder: pip install \.$"):
        kernel.bind_kernel_call(function, Two, n=3)()
