"""Reading of text tables with lines of equal length and fixed columns: a star catalogue, Earth orientation."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ship_geometry.rotations import FloatArray
from ship_kernels import compiled_arrays

Columns = tuple[int, int]
"""First and last character of a number in its line, counted from 1 as in the ReadMe of a catalogue."""


def read_lines(path: Path, length: int) -> NDArray[np.uint8]:
    r"""Return the characters of a file, shape (lines, length); each line ends with its newline.

    Raises:
        ValueError: the file is empty, its size is not a multiple of ``length``, or its first line has another length.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     table = Path(folder) / "table.dat"
        ...     _ = table.write_text("1.50\n2.25\n")
        ...     read_lines(table, length=5).shape
        (2, 5)
    """
    raw = path.read_bytes()
    if not raw or len(raw) % length or raw[length - 1 : length] != b"\n":
        raise ValueError(f"lines of {length - 1} characters each are expected")
    return np.frombuffer(raw, dtype=np.uint8).reshape(-1, length)


def numbers(lines: NDArray[np.uint8], *columns: Columns) -> FloatArray:
    r"""Return the numbers in some columns, shape (columns, lines), exactly as ``float`` reads them; NaN if blank.

    Raises:
        ValueError: the text in a column is not a number.

    Example:
        >>> lines = np.frombuffer(b"  1.50 -7\n -0.25   \n", dtype=np.uint8).reshape(-1, 10)
        >>> print(numbers(lines, (1, 6), (7, 9)))
        [[ 1.5  -0.25]
         [-7.     nan]]
    """
    found: FloatArray
    found, plain = compiled_arrays.plain_numbers(lines, np.array(columns, dtype=np.intp))
    for column, row in np.argwhere(~plain).tolist():
        first, last = columns[column]
        found[column, row] = float(bytes(lines[row, first - 1 : last]))
    return found
