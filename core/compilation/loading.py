"""Kernels from numba's cache without the compiler: what is compiled already needs nothing of what compiles.

numba's own cache loads, before it looks for a function, all that it can compile: NumPy in LLVM, and for its linear
algebra `scipy.linalg`. That is of use only where a kernel is not there yet: numba's compiler loads it then by itself.
Without this file a tiny `bench run` takes 1.00 s of processor time, with it .63 s.
"""

from contextlib import suppress
from functools import cache
from os import makedirs
from os.path import isfile
from pathlib import Path
from typing import Any, NamedTuple, cast, final

from llvmlite.binding import add_symbol
from numba.core.caching import CompileResultCacheImpl, FunctionCache
from numba.core.runtime import _nrt_python  # type: ignore[attr-defined]
from numba.core.types import unliteral

from calibench.core.compilation.compiled import kernel_folder, tell_compiling
from calibench.core.compilation.shipped import kept_of


@final
class _Locator(NamedTuple):
    """Tells numba where the machine code of a function is kept; of one that stands in no file it knows nothing."""

    file: str
    line: int

    @classmethod
    def from_function(cls, function: Any, file: str) -> Any:
        return cls(file, function.__code__.co_firstlineno) if isfile(file) else None

    def get_cache_path(self) -> str:
        return str(kernel_folder(Path(self.file).resolve()))

    def ensure_cache_path(self) -> None:
        makedirs(self.get_cache_path(), exist_ok=True)

    def get_source_stamp(self) -> str:
        return ""  # the folder's name is one

    def get_disambiguator(self) -> str:
        return str(self.line)


@final
class _Files(CompileResultCacheImpl):
    _locator_classes: list[Any] = [_Locator, *CompileResultCacheImpl._locator_classes]  # noqa: RUF012  # numba's

    def reduce(self, cres: Any) -> Any:
        kept = super().reduce(cres)  # type: ignore[no-untyped-call]
        return *kept[:6], "", *kept[7:]  # without a listing for people, which has the path of the source


@final
class KernelCache(FunctionCache):
    """numba's cache of a function, which loads no compiler, and looks through what came with the installation too."""

    _impl_class = _Files

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return what is kept for these types; None where nothing is, or what cannot be read, as of a full disk."""
        _name_helpers()
        try:
            with self._guard_against_spurious_io_errors():
                found = self._load_overload(sig, target_context)  # type: ignore[no-untyped-call]
            if found is not None:
                return found
        except Exception:  # of half a pickle nearly anything may come
            try:
                self.flush()  # type: ignore[no-untyped-call]  # it is read again before anything is kept
            except OSError:
                self.disable()  # type: ignore[no-untyped-call]
        with suppress(Exception):  # as above: it is compiled, then
            _, _, code = self._index_key(sig, target_context.codegen())  # type: ignore[no-untyped-call]
            if kept := kept_of(Path(self._cache_path).name, self._impl.filename_base, sig, code):
                return self._impl.rebuild(target_context, kept)
        tell_compiling()
        return None


@cache
def _name_helpers() -> None:
    """Tell the linker where the C functions of numba's counting of references are.

    Kept machine code holds the rest of that counting already; `rtsys.initialize`, which the compiler calls by itself,
    would compile it again.
    """
    for name, address in _nrt_python.c_helpers.items():
        add_symbol(name if name.startswith("_") else f"NRT_{name}", address)


def keep(function: Any) -> Any:
    """Let a function that numba compiles be kept between processes, and be loaded without the compiler."""
    if hasattr(function, "py_func"):  # else it is interpreted
        kept: Any = KernelCache
        function._cache = kept(function.py_func)  # what its `enable_caching` does; it offers no choice of cache
    return function


def without_literals(function: Any) -> Any:
    """Let a kernel that calls `function` with a constant use what is compiled for any number of that type."""
    if hasattr(function, "py_func"):
        template_of, type_of = function.get_call_template, cast(Any, unliteral)

        def plain(args: Any, named: Any) -> Any:
            return template_of(tuple(map(type_of, args)), {name: type_of(kind) for name, kind in named.items()})

        function.get_call_template = plain
    return function


def close(function: Any) -> Any:
    """Refuse calls from Python of a function compiled without an entrance for them: they would end the process.

    Without those entrances an arm's kernels compile in 18.1 s in place of 20.6 s.
    """
    if hasattr(function, "py_func"):
        compiled, name = function.overloads, function.__name__

        def refuse(*_arguments: Any, **_named: Any) -> None:
            raise TypeError(f"{name} is a part of kernels: only they call it, compile it with njit() otherwise")

        # not to what a call from Python looks through
        function.add_overload = lambda result: compiled.update({tuple(result.signature.args): result})
        function._compile_for_args = refuse
    return function
