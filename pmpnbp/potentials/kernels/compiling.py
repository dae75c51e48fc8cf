"""How is a kernel compiled? With the ways in that are taken, and no others.

numba gives every function an entrance for Python and one for C, each compiled and kept. C calls none of these, and
Python few: without the rest the first start takes a tenth less. For the same reason a kernel calls another with the
same types everywhere, `np.int64(0)` for a plain 0, which is a type of its own to numba: each is then compiled once.
"""

from __future__ import annotations

from functools import partial

from numba import njit

# What Python calls; kept on disk together with all that it calls.
kernel = partial(njit, nogil=True, cache=True, no_cfunc_wrapper=True)
# What only kernels call.
inner = partial(njit, nogil=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)
