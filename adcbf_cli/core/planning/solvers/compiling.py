"""How the fast solver is compiled by Numba, and when a compiled one may be used again.

Numba keeps what it compiled on disk and looks at one source file to see whether it is still right. The
solver is made of several. So only its entry is kept, under a key made of all of their sources; the
functions that it calls are in it.
"""

from __future__ import annotations

import hashlib
import inspect
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import ModuleType
from typing import Any, TypeVar

from numba import njit
from numba.core import config
from numba.misc.appdirs import AppDirs

Function = TypeVar("Function", bound=Callable[..., Any])

OPTIONS: dict[str, Any] = {"error_model": "numpy"}
"""No fast mathematics: with it, a process that compiles and one that loads what is kept differ in the last
bits, and it gains nothing here."""


ENDLESS = 1e200
"""What is not smaller than this is no number, or none to go on with."""


def compiled(function: Function) -> Function:
    """Compiled when first called, not kept on disk."""
    result: Function = njit(**OPTIONS)(function)
    return result


def kept(function: Function) -> Function:
    """Compiled when first called, and kept on disk if there is a place for it: Numba's folder in the user's cache,
    or NUMBA_CACHE_DIR."""
    try:
        with _users_cache():
            result: Function = njit(cache=True, **OPTIONS)(function)
    except RuntimeError:  # no place that can be written to
        return compiled(function)
    return result


@contextmanager
def _users_cache() -> Iterator[None]:
    """Within, Numba keeps things in the user's cache, and beside the module only where there is none: an installer
    leaves files there that it does not know of, and their folder then stands for the package that it removed."""
    options: Any = config
    dirs: Any = AppDirs
    chosen = options.CACHE_DIR
    options.CACHE_DIR = chosen or dirs("numba", appauthor=False).user_cache_dir
    try:
        yield
    finally:
        options.CACHE_DIR = chosen


def source_key(*modules: ModuleType) -> str:
    """A key that differs when any module's source does."""
    text = "".join(inspect.getsource(module) for module in modules)
    return hashlib.sha256(text.encode()).hexdigest()
