"""What is in a recording? The tables, and how an array becomes bytes.

| table | holds |
| --- | --- |
| `inputs` | JSON by name: version, method, model name, parts, settings, prior, region (of interest), particles, seed,
max_std (metres, up to which a link was said to be certain) |
| `model` | the model as a zip that can be loaded again |
| `scans` | depth image, camera, frame and stamp of each scan |
| `iterations` | a row an iteration: stage, tolerance, score, seconds, notes; stays when its arrays are thinned out |
| `arrays` | the arrays of an iteration, by the names of `Belief`, `Messages`, `IterationReport` and `State`; and of the
posterior that was read out from it, which stay when the others are thinned out |
| `summaries` | what the program that records has to say of an iteration, in its own words; stays as its row does |
| `changes` | other settings (JSON) or another scan (its number), its mode, and the iteration they came after |
| `notes` | what the writer has to say, such as that it thinned out iterations |
"""

from __future__ import annotations

import json
import zlib

import numpy as np
from numpy.typing import NDArray

# "pmpn"; tells a recording from any other SQLite file.
APPLICATION_ID = 0x706D706E
# Format 1 had no `summaries` and no `changes`.
VERSION = 2

TABLES = """
CREATE TABLE inputs (name TEXT PRIMARY KEY, value TEXT NOT NULL);
CREATE TABLE model (file_name TEXT NOT NULL, zip BLOB NOT NULL);
CREATE TABLE scans (number INTEGER PRIMARY KEY, camera TEXT NOT NULL, frame_id TEXT NOT NULL, stamp REAL,
    dtype TEXT NOT NULL, shape TEXT NOT NULL, depth BLOB NOT NULL);
CREATE TABLE iterations (number INTEGER PRIMARY KEY, stage TEXT NOT NULL, tolerance REAL NOT NULL, mle_score REAL,
    seconds REAL NOT NULL, notes TEXT NOT NULL);
CREATE TABLE arrays (iteration INTEGER NOT NULL, name TEXT NOT NULL, dtype TEXT NOT NULL, shape TEXT NOT NULL,
    data BLOB NOT NULL, UNIQUE (iteration, name));
CREATE TABLE notes (number INTEGER PRIMARY KEY, text TEXT NOT NULL);
"""

# Since format 2.
ADDED_TABLES = """
CREATE TABLE summaries (iteration INTEGER PRIMARY KEY, text TEXT NOT NULL);
CREATE TABLE changes (number INTEGER PRIMARY KEY, after_iteration INTEGER NOT NULL, settings TEXT, scan INTEGER,
    note TEXT NOT NULL, mode TEXT);
"""
# In recordings of format 2 that are older than modes: their scans join.
ADDED_MODE = "ALTER TABLE changes ADD COLUMN mode TEXT"

# What the names of a posterior's arrays begin with, and a condition that those of the iteration itself fulfil.
PREFIX = "posterior."
ITERATION_S_OWN = f"name NOT LIKE '{PREFIX}%'"

# Bytes. What says that it is larger is not unpacked: no array of a recording is.
LARGEST_ARRAY = 1 << 31


def pack(array: NDArray[np.generic]) -> tuple[str, str, bytes]:
    """Type, shape and bytes of an array.

    Its bytes are sorted by their place in a number before they are compressed: sign and exponent of neighbours are
    alike, the rest is noise that no effort makes smaller, hence zlib's fastest level.
    """
    values = np.ascontiguousarray(array)
    little = values.astype(values.dtype.newbyteorder("<"), copy=False)
    planes = little.reshape(-1).view(np.uint8).reshape(-1, little.dtype.itemsize).T
    return little.dtype.str, json.dumps(array.shape), zlib.compress(planes.tobytes(), 1)


def unpack(dtype: str, shape: str, data: bytes, most: int = LARGEST_ARRAY) -> NDArray[np.generic]:
    """The array that `pack` was given. Raises ValueError or zlib.error where the bytes are not its, or it says that it
    takes more than `most` bytes."""
    kind = np.dtype(dtype)
    sizes = tuple(int(size) for size in json.loads(shape))
    if kind.hasobject or min(sizes, default=0) < 0:
        raise ValueError("no array of numbers")
    expected = kind.itemsize * int(np.prod(sizes, dtype=object))
    if expected > most:
        raise ValueError("array too large")
    unpacker = zlib.decompressobj()
    raw = unpacker.decompress(data, expected + 1)
    if len(raw) != expected or (expected and not unpacker.eof and unpacker.decompress(b"", 1)):
        raise ValueError("array of another size")
    planes = np.frombuffer(raw, dtype=np.uint8).reshape(kind.itemsize, -1)
    return np.ascontiguousarray(planes.T).reshape(-1).view(kind).reshape(sizes)
