"""2: recordings of a few megabytes that unpack to gigabytes."""

from __future__ import annotations

import io
import json
import sqlite3
import time
import zipfile
from concurrent.futures import ThreadPoolExecutor

import httpx

from tests.app.attacks import entries
from tests.app.attacks.entries import edited, packed_zeros
from tests.app.attacks.outcome import Outcome
from tests.app.attacks.target import Target
from tests.app.attacks.watch import MIB, Watch, settled_memory

SIZE = 2 << 30
MOST_GROWTH = 300 * MIB
LONGEST = 10.0
# An upload may be read for as long as PMPNBP_PARSE_SECONDS says, 15 s.
LONGEST_UPLOAD = 20.0
BOMBED = 3


def attack(target: Target, outcome: Outcome) -> None:
    """Upload each, then ask twice at once for what bursts."""
    with target.client() as client:
        whole = entries.recording(target, client, 5)
        for name, content in bombs(whole).items():
            outcome.did.append(f"{name}: {len(content) / 1e6:.1f} MB")
            with Watch(target) as watch:
                _one(target, outcome, client, name, content)
            outcome.happened.append(f"{name}: {watch.told()}")
            outcome.expect(watch.growth < MOST_GROWTH, f"{name}: the server's memory grew by {watch.growth // MIB} MiB")
            outcome.expect(not watch.unserved, f"{name}: {watch.unserved} calls of another caller were not served")
            settled_memory(target, watch.before + 50 * MIB, 5)


def bombs(whole: bytes) -> dict[str, bytes]:
    """By name: recordings that say they hold, or do hold, 2 GiB."""
    zeros = packed_zeros(SIZE)

    def array(name: str, shape: list[int] | None, dtype: str | None = None) -> bytes:
        def edit(connection: sqlite3.Connection) -> None:
            where = (BOMBED, name)
            query = "SELECT dtype, shape FROM arrays WHERE iteration = ? AND name = ?"
            known_dtype, known_shape = connection.execute(query, where).fetchone()
            told = known_shape if shape is None else json.dumps(shape)
            values = (dtype or known_dtype, told, zeros, *where)
            connection.execute(
                "UPDATE arrays SET dtype = ?, shape = ?, data = ? WHERE iteration = ? AND name = ?", values
            )

        return edited(whole, edit)

    def depth(connection: sqlite3.Connection) -> None:
        connection.execute(
            "UPDATE scans SET dtype = '<f4', shape = ?, depth = ?", (json.dumps([1 << 15, 1 << 14]), zeros)
        )

    def model(connection: sqlite3.Connection) -> None:
        buffer = io.BytesIO()
        with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as file:
            file.writestr("cabinet.urdf", entries.URDF)
            file.writestr("mesh.obj", bytes(512 * MIB))
        connection.execute("UPDATE model SET zip = ?", (buffer.getvalue(),))

    def particles(connection: sqlite3.Connection) -> None:
        connection.execute("UPDATE inputs SET value = '2000000000' WHERE name = 'particles'")

    def many_notes(connection: sqlite3.Connection) -> None:
        connection.execute("UPDATE iterations SET notes = ? WHERE number = ?", ("[" * (50 * MIB), BOMBED))

    count = SIZE // 8
    return {
        "particles' poses, 2 GiB long": array("belief.poses", [count // (1 << 12), 1 << 12], "<f8"),
        "particles' poses of their own shape, with 2 GiB behind": array("belief.poses", None),
        "a weight for each of 2^28 particles": array("belief.log_weights", [4, count // 4], "<f8"),
        "one number of 2 GiB": array("effective_sample_size", [1], f"|V{SIZE - 1}"),
        "the best poses, as bytes": array("mle", [SIZE], "|u1"),
        "a scan": edited(whole, depth),
        "a model's zip": edited(whole, model),
        "two thousand million particles": edited(whole, particles),
        "notes of 50 MB of brackets": edited(whole, many_notes),
    }


def _one(target: Target, outcome: Outcome, client: httpx.Client, name: str, content: bytes) -> None:
    began = time.monotonic()
    answer = outcome.answered(f"upload of {name}", entries.upload_recording(client, content))
    seconds = time.monotonic() - began
    outcome.expect(seconds < LONGEST_UPLOAD, f"{name}: the upload was answered after {seconds:.1f} s")
    id = target.keep("recordings", answer)
    if id is None:
        outcome.happened.append(f"{name}: upload answered {answer.status_code} after {seconds:.1f} s")
        return
    asked = (f"estimate?iteration={BOMBED}", f"beliefs/drawer1?iteration={BOMBED}", "trace", "graph")
    for path in asked:
        with ThreadPoolExecutor(2) as pool:
            for at, (found, late) in enumerate(pool.map(_get, [target] * 2, [f"/api/v1/sessions/{id}/{path}"] * 2)):
                outcome.answered(f"{path} of {name}", found)
                outcome.expect(late < LONGEST, f"{path} of {name}: answered {found.status_code} after {late:.1f} s")
                if at == 0:
                    outcome.happened.append(f"{name}: {path} {found.status_code} after {late:.1f} s")
    client.delete(f"/api/v1/recordings/{id}")


def _get(target: Target, path: str) -> tuple[httpx.Response, float]:
    began = time.monotonic()
    with target.client(timeout=300) as client:
        answer = client.get(path)
    return answer, time.monotonic() - began
