"""Threads where they pay: for large pieces of work side by side, not inside small arithmetic."""

from __future__ import annotations

import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar
from functools import lru_cache

from threadpoolctl import ThreadpoolController

_limited = ContextVar("limited", default=False)


@contextmanager
def one_for_arrays() -> Iterator[None]:
    """Within it, products and factors of matrices take one thread.

    On matrices of some hundred rows the threads of BLAS wait for each other longer than they
    work, and where a core is busy with something else a hundred times as long. Inside another such
    block it does nothing: to set the limit takes as long as a small program.
    """
    if _limited.get():
        yield
        return
    token = _limited.set(True)
    try:
        with _blas().limit(limits=1):
            yield
    finally:
        _limited.reset(token)


@lru_cache(maxsize=1)
def _blas() -> ThreadpoolController:
    return ThreadpoolController().select(user_api="blas")


@lru_cache(maxsize=1)
def threads() -> ThreadPoolExecutor:
    """One for each core. Work that is given to them gives them none itself."""
    return ThreadPoolExecutor(cores())


def cores() -> int:
    """How much may be done at once: one thing a core, or what `OMP_NUM_THREADS` says.

    Clusters set it, and campaigns do in processes of which there is one for every core.
    """
    told = os.environ.get("OMP_NUM_THREADS", "")
    return int(told) if told.isdecimal() and int(told) > 0 else os.cpu_count() or 1
