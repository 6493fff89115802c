"""Short names of array types, for signatures of kernels."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]  # array of any shape
Array32 = NDArray[np.float32]
Ints = NDArray[np.int64]  # array of indices or counts, of any shape
Data = np.ndarray  # array of any type and shape
