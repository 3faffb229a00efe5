"""The one way tankrig compiles a numerical kernel.

A kernel is called from Python, from other kernels, or both, and is compiled for each in its own way when it is first
called so: for Python with the code that unpacks its arguments, for kernels without. Most kernels are only ever called
by others, and records of arrays take as long to unpack as all the rest, for the compiler.
"""

import fcntl
import gc
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from itertools import count
from pathlib import Path
from types import FunctionType
from typing import Any, TypeVar

F = TypeVar("F", bound=Callable[..., Any])

FAST = {"reassoc", "contract", "arcp", "nsz"}


def kernel(function: F) -> F:
    """Compile `function` to machine code on its first call, keep the code on disk, and release the GIL while it runs.

    A kernel that held the GIL would freeze the window for as long as it ran (measured: 750 ms), and one that was not
    cached would cost every new process seconds. `fastmath` vectorises
    sums but keeps NaN and infinity meaningful.

    Parameters
    ----------
    function
        Numerical code that numba understands: arrays and numbers in, arrays and numbers out.
    """
    return _compiled(function, {})


def part(function: F) -> F:
    """Compile `function` like a `kernel`, and into every kernel that calls it, so that a call costs nothing.

    For the small parts of an inner loop that take a whole scene as their argument (measured: photons 1.6× faster).

    Parameters
    ----------
    function
        As for `kernel`.
    """
    return _compiled(function, {"forceinline": True})


def kept(called: Callable[..., Any]) -> bool:
    """Whether a kernel's code for Python is on disk, for arguments of whatever kinds."""
    return bool(called._cache._cache_file._load_index())  # type: ignore[attr-defined]


def _compiled(function: F, within: dict[str, Any]) -> F:
    """The kernel, which is compiled with the options `within` where another kernel calls it."""
    import numba

    from tankrig.kernel_compiler import ForKernels, ForPython

    options: dict[str, Any] = {"nogil": True, "cache": True, "fastmath": FAST, "error_model": "numpy"}
    options["no_cfunc_wrapper"] = True
    called: Any = numba.njit(**options, pipeline_class=ForPython)(function)
    # What is kept on disk is told apart by the name, and code for kernels must not be taken for code for Python.
    linked = FunctionType(function.__code__, function.__globals__, None, function.__defaults__, function.__closure__)
    linked.__module__, linked.__kwdefaults__ = function.__module__, function.__kwdefaults__
    linked.__qualname__ = f"{function.__qualname__}.linked"
    _with_safe_cache(called)
    called.__class__ = _called_and_linked()
    options |= {"no_cpython_wrapper": True, "pipeline_class": ForKernels}
    called.linked = _with_safe_cache(numba.njit(**options, **within)(linked))
    return called  # type: ignore[no-any-return]


@cache
def _called_and_linked() -> type:
    """Kind of a kernel: numba's own, but for kernels that call it, which get `linked`.

    Numba would compile it anew for every constant that it is called with.
    """
    from numba.core.registry import CPUDispatcher
    from numba.core.types.misc import unliteral

    class Kernel(CPUDispatcher):  # type: ignore[misc]
        def get_call_template(self, args: Any, kws: Any) -> Any:
            named = {name: unliteral(kind) for name, kind in kws.items()}
            return self.linked.get_call_template(tuple(map(unliteral, args)), named)

        def get_overload(self, signature: Any) -> Any:
            return self.linked.get_overload(signature)

        def compile(self, signature: Any) -> Any:
            with _not_collecting():
                return super().compile(signature)

    return Kernel


@contextmanager
def _not_collecting() -> Iterator[None]:
    """Keep Python from looking for circular garbage, of which a compiler makes much (measured: a fifth of its time)."""
    thresholds = gc.get_threshold()
    if thresholds[0]:
        gc.set_threshold(0)
    try:
        yield
    finally:
        if thresholds[0]:
            gc.set_threshold(*thresholds)


def _with_safe_cache(compiled: Any) -> Any:
    """Let an index of compiled code that cannot be read count as empty, and one process at a time write into it.

    An index names the classes of a kernel's arguments, and numba reads it before it sees that it is out of date. After
    an update in which such a class has moved to another module, reading it fails, and the kernel with it.

    Two processes that compile a kernel for arguments of different kinds may choose the same file for both, and numba
    names a file in the index before it writes it: who reads meanwhile takes the one's code for the other's.
    """
    file = compiled._cache._cache_file
    read = file._load_index

    def load_index() -> Any:
        try:
            return read()
        except (ImportError, AttributeError):
            return {}

    def save(key: Any, code: Any) -> None:
        with _alone(Path(file._cache_path)):
            index = load_index()
            free = (file._data_name(number) for number in count(1))
            name = index.get(key) or next(name for name in free if name not in index.values())
            file._save_data(name, code)
            file._save_index({**index, key: name})

    file._load_index, file.save = load_index, save
    return compiled


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Whoever else asks for the same folder waits; where files cannot be locked, nobody does."""
    with (folder / "kernels.lock").open("ab") as file:
        with suppress(OSError):  # a file system that knows no locks
            fcntl.flock(file, fcntl.LOCK_EX)
        yield
