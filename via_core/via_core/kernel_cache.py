"""Lets processes share numba's cache of compiled kernels.

numba numbers the files of a kernel's signatures. Processes that compile different signatures at the same time can
choose the same number, and one signature then gets the code of the other: a crash (numba issue 4807). Here every
compilation writes a file of its own. At worst, an index entry is lost and the kernel is compiled again.
numba calls `init` before its first compilation (entry point `numba_extensions`).
"""

from typing import Any
from uuid import uuid4

from numba.core.caching import IndexDataCacheFile


def init() -> None:
    """Replace the method of numba that saves a compiled signature."""
    IndexDataCacheFile.save = _save


def _save(file: IndexDataCacheFile, key: Any, data: Any) -> None:
    """Write the code to a new file, then enter this into the index."""
    name = file._data_name(uuid4().int)
    file._save_data(name, data)
    file._save_index({**file._load_index(), key: name})
