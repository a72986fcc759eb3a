# What other compiled modules call of compiled_steps.py: pointers to the nine numbers of a matrix, row by row.
cdef void _diagonalise(double* matrix, double* vectors) noexcept
cdef double _larger(double first, double second) noexcept
