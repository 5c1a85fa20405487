"""Compilation of scalar equations with numba, and the cache of compiled kernels.

Equations are plain functions of floats, written once. `inlined` marks those that kernels inline, so that LLVM sees one
flat loop over arms and vectorises it; `compiled` marks the kernels that Python calls, `allocating` those that make
arrays, and `shared` those that several kernels call. With `NUMBA_DISABLE_JIT=1` all leave the functions as they are,
and the very same code runs as plain Python.

No `fastmath`: strict IEEE arithmetic is what makes one arm and arm *i* of a batch agree bit for bit.

**Parts.** numba makes machine code of every function, also of those that only kernels call, and optimises each together
with all that it calls. Here what a kernel calls is a part: numba finds its types and translates it for LLVM, and that
is all. The kernel that Python calls is linked from its parts, and only this whole is optimised, once. Compiling takes
half the time.

**Shared kernels.** Where several kernels call a long one, like the motion of the arms, each would be compiled with it
anew. A kernel that is marked `shared` is compiled once, and the others call its machine code. They know it by a name of
which LLVM is told where it is in a process. A kernel from the cache first loads those that it calls.

**Arrays.** numba counts who refers to an array, by an atomic operation wherever a kernel takes a view of one: a tenth
of the time that a filter takes. A kernel that makes no arrays needs none of this, because its caller holds them. Only
those that are marked `allocating` count, and those of their parts that make or return arrays. All other parts are the
same in all kernels.
"""

from beltarm_env.jit.cache import ANNOUNCEMENT
from beltarm_env.jit.kernels import PLAIN, allocating, code_for, compiled, inlined, shared

__all__ = ["ANNOUNCEMENT", "PLAIN", "allocating", "code_for", "compiled", "inlined", "shared"]
