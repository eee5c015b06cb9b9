"""How the functions of the simulator are compiled.

Functions of the inner loop are compiled without numba's runtime (`_nrt=False`): they allocate nothing, and counting
references to their array arguments took three quarters of the time. They must return no array.
"""

from numba import njit

compiled = njit(cache=True, error_model="numpy", nogil=True)
bare = njit(cache=True, error_model="numpy", nogil=True, _nrt=False)
# What must stay within its caller: LLVM leaves it out once several callers have grown.
inlined = njit(cache=True, error_model="numpy", nogil=True, _nrt=False, forceinline=True)
