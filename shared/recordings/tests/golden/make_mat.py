"""Writes small MAT-files with SciPy, compressed and plain, laid out as those of Ozdemir 2022 and with some that do not fit.

    python make_mat.py        # NumPy 2, SciPy 1.16
"""

from pathlib import Path

import numpy as np
from scipy.io import savemat

here = Path(__file__).parent
rows, columns = np.arange(6)[:, None], np.arange(4)[None, :]
variables = {
    "data": 10.0 * rows + columns + 0.25,
    "fs": 2000.0,
    "iD": np.uint8(7),
    "labels": "ch1",
    "units": "mV",
    "counts": np.array([[1, 2], [3, 4], [5, 6]], dtype=np.uint8),
    "wide": np.ones((2, 3), dtype=np.int16),
    "gap": np.array([[1.0, 1.0], [np.nan, 1.0]], dtype=np.float32),
}
for name, is_compressed in [("compressed", True), ("plain", False)]:
    savemat(here / f"{name}.mat", variables, do_compression=is_compressed)
