"""The LZF decoder against a slow one, an encoder, and rubbish."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from pmpnbp.scene.lzf import lzf_decode
from tests.scene.scan_writers import lzf_encode


def slow_decode(packed: bytes, length: int) -> bytes | None:
    """The same, by list and slice, one code at a time."""
    plain, rest = bytearray(), list(packed)
    try:
        while rest:
            control = rest.pop(0)
            if control < 32:
                if len(rest) <= control:
                    return None
                plain += bytes(rest[: control + 1])
                del rest[: control + 1]
            else:
                count = control // 32 + 2
                count += rest.pop(0) if count == 9 else 0
                source = len(plain) - (control % 32 * 256 + rest.pop(0)) - 1
                if source < 0:
                    return None
                for k in range(count):
                    plain.append(plain[source + k])
    except IndexError:
        return None
    return bytes(plain) if len(plain) == length else None


def test_a_run_is_a_reference_into_itself() -> None:
    # literal "ab", then 8 bytes from 2 back: the reference overlaps what it writes
    assert lzf_decode(bytes([1, 97, 98, (8 - 2) << 5, 1]), 10) == b"ababababab"
    # the long form: 9 + 4 bytes from 1 back
    assert lzf_decode(bytes([0, 97, 7 << 5, 4, 0]), 14) == b"a" * 14


@given(st.lists(st.sampled_from([b"abc", b"abcabd", b"\x00" * 300, b"xyz", b"\xff\x01"]), max_size=40))
def test_decoding_undoes_encoding(pieces: list[bytes]) -> None:
    plain = b"".join(pieces)
    assert lzf_decode(lzf_encode(plain), len(plain)) == plain


@given(st.binary(max_size=60), st.integers(0, 600))
def test_any_bytes_decode_as_the_slow_decoder_says(packed: bytes, length: int) -> None:
    assert lzf_decode(packed, length) == slow_decode(packed, length)


@given(st.lists(st.sampled_from([0, 1, 31, 32, 33, 64, 224, 255]), max_size=30), st.integers(0, 300))
def test_codes_that_reach_out_of_bounds(packed: list[int], length: int) -> None:
    assert lzf_decode(bytes(packed), length) == slow_decode(bytes(packed), length)
