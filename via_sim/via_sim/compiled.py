"""How functions of the parameter row are compiled: with numba's runtime, or without it for the inner loop.

Bare functions allocate nothing and return no array: counting references to array arguments took three quarters of the
time.
"""

from numba import njit

compiled = njit(cache=True, error_model="numpy", nogil=True)
bare = njit(cache=True, error_model="numpy", nogil=True, _nrt=False)
# What must stay within its caller: LLVM leaves it out once several callers have grown.
inlined = njit(cache=True, error_model="numpy", nogil=True, _nrt=False, forceinline=True)
