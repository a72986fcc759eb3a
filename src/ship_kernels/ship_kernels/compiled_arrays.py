# cython: language_level=3, infer_types=True
# cython: boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""Compiled check of array shapes, for the modules whose loops do not check bounds, and reading of text tables.

The reading is described at its caller, :mod:`ship_geometry.text_tables`.
"""

import cython
import numpy as np

if not cython.compiled:
    raise ImportError(f"{__name__} is not compiled: run make setup, or colcon build")

from cython.cimports.libc.math import NAN


def check(what: str, fits: bool) -> None:
    """Raise an error if the shapes of arrays do not match.

    Args:
        what: name of the arrays, for the error text.
        fits: True if the shapes match.

    Raises:
        ValueError: the shapes do not match.

    Example:
        >>> check("rates", (4, 3)[1] == 3)
    """
    if not fits:
        raise ValueError(f"{what}: the shapes of the arrays do not fit together")


_BLANK = cython.declare(cython.uchar, 32)
_MINUS = cython.declare(cython.uchar, 45)
_POINT = cython.declare(cython.uchar, 46)
_ZERO = cython.declare(cython.uchar, 48)
_MOST_DIGITS = cython.declare(cython.int, 15)
"""Maximum number of digits of a plain number; integers and powers of ten of this size are exact as doubles."""


def plain_numbers(records: cython.const[cython.uchar][:, :], columns: cython.const[cython.Py_ssize_t][:, :]):
    """Return the numbers in columns of n lines, shape (c, n), and True for each plain number, shape (c, n).

    A plain number has optional blanks and minus, 1 to 15 digits with at most one point, and optional blanks. The digits
    form an integer that is divided once by a power of ten, which rounds as ``float`` does. A blank column is a plain
    number, NaN; a number that is not plain is returned as zero.

    Args:
        records: characters of the lines, shape (n, length).
        columns: first and last character of each column, counted from 1, shape (c, 2).
    """
    of_numbers = np.zeros((columns.shape[0], records.shape[0]))
    of_plain = np.zeros((columns.shape[0], records.shape[0]), dtype=bool)
    numbers: cython.double[:, ::1] = of_numbers
    plain: cython.uchar[:, ::1] = of_plain.view(np.uint8)
    check("columns", columns.shape[1] == 2)
    for c in range(columns.shape[0]):
        check("columns", 1 <= columns[c, 0] <= columns[c, 1] <= records.shape[1])
    for row in range(records.shape[0]):
        for c in range(columns.shape[0]):
            plain[c, row] = _read(records, row, columns[c, 0] - 1, columns[c, 1], cython.address(numbers[c, row]))
    return of_numbers, of_plain


@cython.cfunc
@cython.exceptval(check=False)
def _read(
    records: cython.const[cython.uchar][:, :],
    row: cython.Py_ssize_t,
    at: cython.Py_ssize_t,
    end: cython.Py_ssize_t,
    number: cython.p_double,
) -> cython.bint:
    """Read the number between two characters of a line; return False if the number is not plain."""
    whole: cython.double = 0.0
    power: cython.double = 1.0
    digits: cython.int = 0
    negative: cython.bint
    pointed: cython.bint = False
    character: cython.uchar
    while at < end and records[row, at] == _BLANK:
        at += 1
    if at == end:
        number[0] = NAN
        return True
    negative = records[row, at] == _MINUS
    at += negative
    while at < end:
        character = records[row, at]
        if _ZERO <= character <= _ZERO + 9:
            whole = 10.0 * whole + (character - _ZERO)
            power = 10.0 * power if pointed else power
            digits += 1
        elif character == _POINT and not pointed:
            pointed = True
        else:
            break
        at += 1
    while at < end and records[row, at] == _BLANK:
        at += 1
    if at < end or not 0 < digits <= _MOST_DIGITS:
        return False
    number[0] = (-whole if negative else whole) / power
    return True
