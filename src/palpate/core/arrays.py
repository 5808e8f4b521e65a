"""Types of the arrays in signatures, and sums of long arrays that wake no threads of BLAS.

BLAS sums arrays of more than 10,000 numbers in threads of its own. After each sum they spin for some 20 ms on the
cores that the compiled steps need. Numpy's own sums need no threads, and their bits do not depend on any number of
threads.
"""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Singles = NDArray[np.float32]
Complex = NDArray[np.complex128]


def euclidean_norm(field: Floats) -> float:
    """Return the root of the sum of squares of an array of any shape."""
    return float(np.sqrt(np.sum(np.square(field))))


def sum_of_products(first: Floats, second: Floats) -> float:
    """Return the sum of the products of the entries of two arrays of one shape."""
    return float(np.sum(first * second))
