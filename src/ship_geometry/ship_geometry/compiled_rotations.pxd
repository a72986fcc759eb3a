# Functions of compiled_rotations.py for other compiled modules; pointers are to three elements, or to nine, row by row.
cdef void _exponential(double* v, double* out) noexcept
cdef void _jacobian(double* v, double* out) noexcept
cdef void _times(double* left, double* right, double* out) noexcept
