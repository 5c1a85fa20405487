"""Engine: kernels, written in Python and run as C.

Equations are plain functions of numbers, written once. `inlined` marks those that are written into the loops of
kernels, so that a compiler sees one flat loop over arms and vectorises it; `compiled` marks the kernels that Python
calls. The C of both comes from the same Python (`translation`), is what `eval/export.py` writes for a drive, and gives
the bits of plain Python: sums and products are rounded one by one, in their order.
"""

from beltarm_env.engine.kernels import ENGINE, PLAIN, bound, compiled, in_threads, inlined, with_constants

__all__ = ["ENGINE", "PLAIN", "bound", "compiled", "in_threads", "inlined", "with_constants"]
