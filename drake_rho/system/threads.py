"""Threads for large independent computations, but not inside the arithmetic of small ones."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar
from functools import lru_cache, wraps
from typing import ParamSpec, TypeVar

from threadpoolctl import ThreadpoolController

_limited = ContextVar("limited", default=False)

_Arguments = ParamSpec("_Arguments")
_Result = TypeVar("_Result")


def single_threaded_blas(function: Callable[_Arguments, _Result]) -> Callable[_Arguments, _Result]:
    """Return a function during which BLAS and LAPACK use one thread.

    For matrices of some hundred rows, threads of BLAS wait for each other longer than they work,
    and a hundred times as long if a core is busy otherwise. A nested call sets nothing, because
    setting the limit takes as long as solving a small program.
    """

    @wraps(function)
    def run(*args: _Arguments.args, **kwargs: _Arguments.kwargs) -> _Result:
        if _limited.get():
            return function(*args, **kwargs)
        with _one_thread():
            return function(*args, **kwargs)

    return run


@contextmanager
def _one_thread() -> Iterator[None]:
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
def thread_pool() -> ThreadPoolExecutor:
    """Return the shared pool of one thread per core. Its tasks must not submit tasks to it.

    A forked process gets its own pool, since a fork has none of its parent's threads.
    """
    return ThreadPoolExecutor(thread_count())


if hasattr(os, "register_at_fork"):  # absent on Windows, which has no fork
    os.register_at_fork(after_in_child=thread_pool.cache_clear)


def thread_count() -> int:
    """Return the number of threads to use: `OMP_NUM_THREADS`, by default the number of cores.

    Clusters set this variable, and so do campaigns in their processes, one for every core.
    """
    value = os.environ.get("OMP_NUM_THREADS", "")
    return int(value) if value.isdecimal() and int(value) > 0 else os.cpu_count() or 1
