"""Decorators that compile functions of the parameter row, with numba's runtime or without it for inner loops.

Functions compiled with `bare` must not allocate or return arrays. They avoid reference counting of array arguments,
which took three quarters of the run time.
"""

from numba import njit

compiled = njit(cache=True, error_model="numpy", nogil=True)
bare = njit(cache=True, error_model="numpy", nogil=True, _nrt=False)
# For functions that must be inlined: LLVM stops inlining when several callers are large.
inlined = njit(cache=True, error_model="numpy", nogil=True, _nrt=False, forceinline=True)
