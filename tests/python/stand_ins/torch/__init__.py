"""The few parts of PyTorch that lerobot's datasets use, on NumPy.

Only for machines without PyTorch, whose package is several gigabytes: an installed one is used instead.
"""

import types

import numpy

from . import utils  # noqa: F401


class Tensor(numpy.ndarray):
    """A NumPy array under the name of PyTorch's type."""


class Never:
    """Stands for types that lerobot names in signatures, or with which `datasets` compares values."""


device = dtype = Generator = Never
nn = types.SimpleNamespace(Module=Never)


def tensor(values) -> Tensor:
    values = numpy.asarray(values)
    # PyTorch uses single precision unless another type is stated.
    if values.dtype == numpy.float64:
        values = values.astype(numpy.float32)
    return values.view(Tensor)


def stack(tensors) -> Tensor:
    return numpy.stack(tensors).view(Tensor)


def BoolTensor(values) -> Tensor:  # noqa: N802
    return numpy.asarray(values, dtype=bool).view(Tensor)
