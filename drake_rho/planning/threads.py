"""Threads where they pay: for programs side by side, not inside the arithmetic of a small one."""

from __future__ import annotations

from contextlib import AbstractContextManager
from functools import lru_cache

from threadpoolctl import ThreadpoolController


def one_for_arrays() -> AbstractContextManager[object]:
    """Within it, products and factors of matrices take one thread.

    On matrices of some hundred rows the threads of BLAS wait for each other longer than they
    work, and where a core is busy with something else a hundred times as long.
    """
    limit: AbstractContextManager[object] = _blas().limit(limits=1)
    return limit


@lru_cache(maxsize=1)
def _blas() -> ThreadpoolController:
    return ThreadpoolController().select(user_api="blas")
