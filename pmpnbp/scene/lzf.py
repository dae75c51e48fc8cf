"""What did LZF pack? The decoder for compressed PCD files.

A control byte below 32 announces that many bytes plus one as they stand. Any other one repeats what was already
unpacked: its top three bits are the length less two (7: a further byte adds to it), its low five bits and the byte
after are the distance back, less one. The format is M. Lehmann's LibLZF.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray


def lzf_decode(packed: bytes, length: int) -> bytes | None:
    """The `length` bytes that `packed` unpacks to; None where it is damaged or unpacks to another length."""
    plain = np.empty(length, dtype=np.uint8)
    if _decode(np.frombuffer(packed, dtype=np.uint8), plain) != length:
        return None
    return plain.tobytes()


@numba.njit(cache=True, nogil=True)
def _decode(packed: NDArray[np.uint8], plain: NDArray[np.uint8]) -> np.int64:
    """Fill `plain` from `packed`; how many bytes it took, or -1 where a code reaches out of either array."""
    # Wide integers throughout: control bytes are shifted beyond eight bits.
    read, written = np.int64(0), np.int64(0)
    while read < packed.size:
        control = np.int64(packed[read])
        read += 1
        if control < 32:
            count = control + 1
            if read + count > packed.size or written + count > plain.size:
                return np.int64(-1)
            for k in range(count):
                plain[written + k] = packed[read + k]
            read += count
            written += count
            continue
        count = (control >> 5) + 2
        if count == 9:
            if read >= packed.size:
                return np.int64(-1)
            count += np.int64(packed[read])
            read += 1
        if read >= packed.size:
            return np.int64(-1)
        source = written - (((control & 31) << 8) | np.int64(packed[read])) - 1
        read += 1
        if source < 0 or written + count > plain.size:
            return np.int64(-1)
        # Byte by byte: source and target may overlap, which repeats the piece between them.
        for k in range(count):
            plain[written + k] = plain[source + k]
        written += count
    return written
