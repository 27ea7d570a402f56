"""The few parts of PyTorch that lerobot's data sets use, on NumPy.

Only for machines without PyTorch, whose package is several gigabytes: an installed one is used instead.
"""

import types

import numpy

from . import utils  # noqa: F401


class Tensor(numpy.ndarray):
    """An array with the name of a tensor."""


class Never:
    """What lerobot names in signatures, and `datasets` compares types with."""


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
