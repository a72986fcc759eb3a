"""All compiled arithmetic of the suite: arrays in, arrays out, without names of states and without messages.

Each module is Python with C types, compiled by Cython when the package is built; there is no second implementation.
The counter of a loop over a range has the C type of the range (``infer_types``) and is not declared. The functions are
documented where they are called; the tests compare them with numpy or scipy. The result for a row does not depend on
the number of rows in a call.
"""

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
