"""For every test of the tree: one cache of compiled kernels per worker.

Workers that fill numba's cache at the same time can give one signature the code of another (numba issue 4807): a crash.
"""

import os

if worker := os.environ.get("PYTEST_XDIST_WORKER"):
    os.environ["NUMBA_CACHE_DIR"] = os.path.join(os.environ.get("NUMBA_CACHE_DIR", ".numba_cache"), worker)
