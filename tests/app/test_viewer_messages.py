"""What becomes of what a browser sends to a 3D view?"""

from __future__ import annotations

import asyncio
import logging
import math
import struct
from collections.abc import Callable
from typing import Any

import pytest
from websockets.exceptions import ConnectionClosed

from tests.app.test_viewer_proxy import SESSION, connect, do, with_one_session


@pytest.fixture(scope="module")
def viewed(serve_for_module: Callable[..., Any]) -> Any:
    return with_one_session(serve_for_module())


def packed(value: Any) -> bytes:
    """MessagePack of small things."""
    if isinstance(value, dict):
        pairs = b"".join(packed(key) + packed(member) for key, member in value.items())
        return bytes([0x80 + len(value)]) + pairs
    if isinstance(value, tuple):
        return bytes([0x90 + len(value)]) + b"".join(map(packed, value))
    if isinstance(value, str):
        return bytes([0xA0 + len(value)]) + value.encode()
    return struct.pack(">Bd", 0xCB, value) if isinstance(value, float) else struct.pack(">BH", 0xCD, value)


def camera(**members: Any) -> bytes:
    """What a browser says of where it looks from."""
    looks = {"wxyz": (1.0, 0.0, 0.0, 0.0), "position": (1.0, 1.0, 1.0), "look_at": (0.0, 0.0, 0.0), "fov": 1.0}
    rest = {"up_direction": (0.0, 0.0, 1.0), "image_height": 400, "image_width": 400, "near": 0.01, "far": 100.0}
    return packed({"type": "ViewerCameraMessage", **looks, **rest, **members})


RUBBISH: tuple[bytes | str, ...] = (
    "text",
    b"",
    b"\xc1",
    b"\x91" * 100_000 + b"\xc0",
    packed(("ViewerCameraMessage",)),
    packed({"a": 1}),
    packed({"type": 5}),
    packed({"type": "Nothing"}),
    packed({"type": "ViewerCameraMessage"}),
    packed({"type": "ScenePointerMessage", "ray_origin": 5}),
)


@pytest.mark.parametrize("rubbish", RUBBISH)
def test_what_is_no_message_of_a_view_ends_the_connection_and_nothing_else(
    viewed: Any, caplog: pytest.LogCaptureFixture, rubbish: bytes | str
) -> None:
    async def talk() -> int | None:
        async with connect(viewed, f"/sessions/{SESSION}/view/rubbish") as other:
            async with connect(viewed, f"/sessions/{SESSION}/view/rubbish") as connection:
                await connection.send(rubbish)
                with pytest.raises(ConnectionClosed) as closed:
                    while True:
                        await connection.recv()
            await other.send(camera())
            await other.ping()
            assert closed.value.rcvd is not None
            return closed.value.rcvd.code

    assert do(talk()) == 1003
    assert [record for record in caplog.records if record.levelno >= logging.WARNING] == []


def test_a_browser_that_looks_nowhere_is_not_listened_to(viewed: Any) -> None:
    async def positions() -> set[tuple[float, ...]]:
        async with connect(viewed, f"/sessions/{SESSION}/view/nowhere") as connection:
            for number in (math.nan, math.inf, -math.inf):
                await connection.send(camera(position=(number, 0.0, 0.0)))
                await connection.send(camera(look_at=(0.0, number, 0.0)))
            await connection.send(camera(position=(3.0, 2.0, 1.0)))
            server = viewed.app.state.views._views[SESSION, "nowhere"].server
            while True:
                seen = {tuple(client.camera.position) for client in server.get_clients().values()}
                if (3.0, 2.0, 1.0) in seen:
                    return seen
                await asyncio.sleep(0.01)

    assert do(positions()) == {(3.0, 2.0, 1.0)}
