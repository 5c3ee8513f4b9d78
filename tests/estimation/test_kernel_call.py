"""Calls of the compiled kernels: which arrays they take."""

import numpy as np
import pytest

from bodylog.estimation.inference import kernel_call, kernels
from bodylog.estimation.inference.compiler import Kernel

EVIDENCE = {name: np.zeros(3) for name in ("dt", "y", "ratio", "squares", "logs", "lag")}
EVIDENCE |= {"fresh": np.ones(3, bool), "counts": np.ones(3, bool), "order": 2, "vague": 1.0, "usual": 1.0}


def test_a_call_writes_where_the_arrays_are():
    given = {name: value.copy() if isinstance(value, np.ndarray) else value for name, value in EVIDENCE.items()}
    kernel_call.bind_kernel_call("weigh_noise_ratios", **given)()
    assert (given["logs"] == pytest.approx(3 * np.log(2.0))) and not given["squares"].any()


@pytest.mark.parametrize("array", [np.zeros(3, np.float32), np.zeros(3, int), np.zeros((3, 4)), np.zeros(6)[::2]])
def test_arrays_of_another_type_or_order_are_named(array):
    with pytest.raises(AssertionError, match=r"^squares"):
        kernel_call.bind_kernel_call("weigh_noise_ratios", **EVIDENCE | {"squares": array})


def test_arguments_that_a_kernel_does_not_know_are_named():
    with pytest.raises(AssertionError, match="more"):
        kernel_call.bind_kernel_call("weigh_noise_ratios", **EVIDENCE, more=None)


def test_an_array_that_is_read_may_be_read_only():
    ratio = np.zeros(3)
    ratio.flags.writeable = False
    kernel_call.bind_kernel_call("weigh_noise_ratios", **EVIDENCE | {"ratio": ratio})()


def test_an_installation_compiles_every_kernel():
    kernel_call.load_kernels()
    declared = {name for name, one in vars(kernels).items() if isinstance(one, Kernel)}
    assert set(kernel_call.KERNELS) == declared
