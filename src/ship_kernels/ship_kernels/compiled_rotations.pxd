# Functions of compiled_rotations.py for other compiled modules. A vector has three elements, a matrix nine, row by row.
cdef void _copy(const double[:, :] matrix, double* out) noexcept
cdef void _exponential(double* v, double* out) noexcept
cdef void _jacobian(double* v, double* out) noexcept
cdef void _times(double* left, double* right, double* out) noexcept
