"""Triton's interpreter (3.9) looks through all of its language at each call of a function within a kernel, for what is
to be replaced. Once a kernel is enough, and twice as fast where kernels call many functions."""

import inspect
from collections.abc import Callable
from typing import Any


def hasten() -> None:
    """Teach the interpreter to replace what it has to only once, until the kernel ends."""
    import triton.language as tl
    from triton.runtime import interpreter

    if not hasattr(interpreter, "_LangPatchScope"):
        return  # another version: it is slow, and right
    replace: Callable[[Any], Any] = interpreter._patch_lang
    done: set[str] = set()

    class Scope(interpreter._LangPatchScope):  # type: ignore[misc]
        def restore(self) -> None:
            done.clear()
            super().restore()

    def once(fn: Any) -> Any:
        modules = {x.__name__ for x in fn.__globals__.values() if inspect.ismodule(x) and x in (tl, tl.core, tl.math)}
        if modules <= done:
            return Scope()
        done.update(modules)
        return replace(fn)

    interpreter._LangPatchScope = Scope
    interpreter._patch_lang = once
