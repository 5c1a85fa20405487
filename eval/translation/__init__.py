"""Translation of kernels to C: the restricted Python that numba compiles, function by function, type by type."""
