"""How is a kernel compiled? With the ways in that are taken, and no others.

numba gives every function an entrance for Python and one for C, each compiled and kept. C calls none of these, and
Python few: without the rest the first start takes a tenth less. For the same reason a kernel calls another with the
same types everywhere, `np.int64(0)` for a plain 0, which is a type of its own to numba: each is then compiled once.
Divisions are numpy's: a kernel looks for zeros itself where there may be any, and none raises an exception.
"""

from __future__ import annotations

from functools import partial
from typing import Any

from numba import njit, types
from numba.core import cgutils
from numba.extending import intrinsic
from numba.np.arrayobj import make_array

# What Python calls; kept on disk together with all that it calls.
kernel = partial(njit, error_model="numpy", nogil=True, cache=True, no_cfunc_wrapper=True)
# What only kernels call.
inner = partial(njit, error_model="numpy", nogil=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)


@intrinsic
def borrowed(_: Any, value: Any) -> Any:
    """Arrays, or tuples of them, without their owners, for as long as whoever called the kernel holds these.

    numba counts the references to an array whenever a function takes it out of a tuple or a slice of it: a locked
    instruction each time, and two threads that share an image wait for each other at its counter.
    """

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return _without_owners(context, builder, signature.args[0], arguments[0])

    return value(value), generate


def _without_owners(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    if isinstance(kind, types.BaseTuple):
        members = zip(kind, cgutils.unpack_tuple(builder, value), strict=True)
        return context.make_tuple(builder, kind, [_without_owners(context, builder, *member) for member in members])
    if isinstance(kind, types.Array):
        array = make_array(kind)(context, builder, value=value)
        array.meminfo = cgutils.get_null_value(array.meminfo.type)
        array.parent = cgutils.get_null_value(array.parent.type)
        return array._getvalue()
    return value
