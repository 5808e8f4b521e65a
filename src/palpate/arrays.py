"""Types of the arrays in signatures."""

import numpy as np
from numpy.typing import NDArray

__all__ = ["Complex", "Floats", "Ints", "Singles"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Singles = NDArray[np.float32]
Complex = NDArray[np.complex128]
