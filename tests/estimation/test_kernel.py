"""The compiled library: found, missing, and given addresses of arrays."""

import numpy as np
import pytest

from bodylog.errors import UsageError
from bodylog.estimation.inference import kernel


def test_library_loads_once():
    assert kernel.library() is kernel.library()


@pytest.mark.parametrize("content", [None, b"not a library"])
def test_missing_or_broken_library_is_one_line_with_the_command(tmp_path, monkeypatch, content):
    monkeypatch.setattr(kernel, "LIBRARY", tmp_path / "libkernel.so")
    if content:
        kernel.LIBRARY.write_bytes(content)
    with pytest.raises(UsageError, match=r"library is missing or does not load: .*libkernel\.so.*: pip install \.$"):
        kernel.library.__wrapped__()


@pytest.mark.parametrize("dtype", [float, np.uint8])
def test_pointer_is_the_address_of_the_first_element(dtype):
    array = np.zeros((3, 4), dtype)
    assert kernel.pointer(array[1:]).value == array.ctypes.data + array.strides[0]
    assert kernel.pointer(None).value is None


@pytest.mark.parametrize("array", [np.zeros(3, np.float32), np.zeros(3, bool), np.zeros((3, 4)).T, np.zeros(6)[::2]])
def test_pointer_takes_no_other_type_or_order(array):
    with pytest.raises(AssertionError):
        kernel.pointer(array)
