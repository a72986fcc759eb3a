# Functions of compiled_kalman.py for other compiled modules; a pointer is to the nine elements of a matrix, row by row.
cdef void _diagonalise(double* matrix, double* vectors) noexcept
cdef double _larger(double first, double second) noexcept
