# What other compiled modules call of compiled_rotations.py: pointers to three numbers, and to nine, row by row.
cdef void _exponential(double* v, double* out) noexcept
cdef void _jacobian(double* v, double* out) noexcept
cdef void _times(double* left, double* right, double* out) noexcept
