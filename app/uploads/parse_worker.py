"""What is in an uploaded file? Read here, in a process of its own that has nothing to lose.

    python -m app.uploads.parse_worker BYTES SECONDS

BYTES of memory is what the process may take, SECONDS of processor time what a file may take; past either the process
dies or says so. Standard input is a socket over which connections come, and a process is forked for each. It says
`{"ready": true, "pid": …}`, then reads files by the line, `{"kind", "path", "camera", "out"}` as JSON, the kind being
models, scans or recordings, and answers each with a line: `{"summary": {…}}` or `{"error": "a sentence"}`. It ends with
its connection. Of a model and scans that were taken in it also says, to `{"kind": "regions", "path", "scans"}`, where
the one may stand in the others.
"""

from __future__ import annotations

import json
import os
import re
import resource
import socket
import sqlite3
import sys
import tempfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import IO, Any
from urllib.parse import quote

from app.memory import keep_for_good
from app.uploads.forking import fork_for_each
from pmpnbp.errors import PmpnbpError, RecordingError
from pmpnbp.importing import many_modules
from pmpnbp.names import name_fault

# Of one file: a mesh that a zip unpacks to, or the scan that is written.
LARGEST_OUTPUT = 512 << 20
Job = dict[str, Any]
Summary = dict[str, Any]
Readers = dict[str, Callable[[Job], Summary]]


def main(memory: int, seconds: float) -> None:
    """Have files read until standard input, a socket, ends."""
    # A system that lacks a limit (macOS has no RLIMIT_AS) still has the wall clock of the parent.
    for limit, value in (
        (resource.RLIMIT_AS, memory),
        (resource.RLIMIT_FSIZE, LARGEST_OUTPUT),
        (resource.RLIMIT_CORE, 0),
    ):
        with suppress(ValueError, OSError):
            resource.setrlimit(limit, (value, value))
    with many_modules():
        readers = _readers()
    keep_for_good()
    with socket.socket(fileno=os.dup(sys.stdin.fileno())) as control:
        fork_for_each(control, lambda connection: _serve(connection, readers, seconds))


def _serve(connection: socket.socket, readers: Readers, seconds: float) -> None:
    jobs, answers = connection.makefile("r", encoding="utf-8"), connection.makefile("w", encoding="ascii")
    _say(answers, {"ready": True, "pid": os.getpid()})
    for line in jobs:
        _allow_processor_time(seconds)
        job = json.loads(line)
        # what a killed process leaves goes with the upload; beside what is stored already nothing may be left
        tempfile.tempdir = None if job["kind"] == "regions" else str(Path(job["path"]).parent)
        _say(answers, _answer(readers[job["kind"]], job))


def _answer(read: Callable[[Job], Summary], job: Job) -> dict[str, Any]:
    name = Path(job["path"]).name
    try:
        return {"summary": read(job)}
    except PmpnbpError as error:
        return {"error": str(error)}
    except MemoryError:
        return {"error": f"'{name}' takes more memory to read than an upload may"}
    except RecursionError:
        return {"error": f"'{name}' is nested too deeply to be read"}
    except Exception as error:  # no closed list of what a hostile file makes a library raise
        return {"error": f"'{name}' cannot be read: it is damaged", "unexpected": f"{type(error).__name__}: {error}"}


def _readers() -> Readers:
    """The readers by kind, with everything they need imported: later nothing is."""
    from app.uploads.summaries import read_model, read_regions, read_scan
    from pmpnbp.recording import Recording
    from pmpnbp.recording.reopening import last_shown
    from pmpnbp.scene import lzf

    lzf.lzf_decode(b"\0a", 1)
    return {
        "models": lambda job: read_model(Path(job["path"])),
        "scans": lambda job: read_scan(
            Path(job["path"]), Path(job["camera"]) if job["camera"] else None, Path(job["out"])
        ),
        "regions": lambda job: read_regions(Path(job["path"]), [Path(path) for path in job["scans"]]),
        "recordings": lambda job: _recording(job, Recording, last_shown),
    }


def _recording(job: Job, open_recording: Callable[[Path], Any], last_shown: Callable[[Any], int | None]) -> Summary:
    path = Path(job["path"])
    _check_tables(path)
    with open_recording(path) as recording:
        recording.distrust()
        # what comes behind some damage is not looked for: as far as it is whole it can be shown
        last = last_shown(recording)
        if last is None:
            raise RecordingError(f"recording '{path.name}' has no iteration that can be read")
        iterations = [number for number in recording.iterations() if number <= last]
        # whoever looks at it later makes its problems in the server's own process: that has to go well here first
        problem = recording.problem(last)
        with tempfile.TemporaryDirectory(prefix="recording-") as folder:
            scans = [*recording.restored_inputs(Path(folder), 0).scans]
        for change in recording.changes(last):
            recording.problem(change.after_iteration)
            scans += [] if change.scan is None else [change.scan]
        for number, scan in enumerate(scans):
            if fault := name_fault(scan.frame_id):
                raise RecordingError(f"the frame of scan {number} of recording '{path.name}' {fault}")
        with suppress(RecordingError):
            recording.summaries()
        return {
            "model": problem.mrf.model.name,
            "method": problem.method,
            "particles": problem.particles,
            "seed": problem.seed,
            "parts": [part.name for part in problem.mrf.model.parts],
            "scans": problem.observation.scan_count,
            "iterations": len(iterations),
            "first_iteration": iterations[0],
            "last_iteration": iterations[-1],
            "notes": _notes(recording, last),
        }


def _notes(recording: Any, last: int) -> list[str]:
    """What the writer had to say, and whether something is missing behind iteration `last`."""
    notes: list[str] = []
    newest = None
    with suppress(RecordingError):
        newest = recording.newest()
        notes = recording.notes()
    return notes if newest == last else [*notes, f"what comes after iteration {last} is damaged and is left out"]


def _check_tables(path: Path) -> None:
    """Only plain tables: a view, a trigger or a computed column would run the sender's queries whenever it is read."""
    connection = sqlite3.connect(f"file:{quote(str(path.absolute()))}?mode=ro&immutable=1", uri=True)
    try:
        # else a file that was cut short is refused as a whole; opened read-only, nothing can be harmed
        connection.execute("PRAGMA writable_schema = ON")
        rows = connection.execute("SELECT type, name, sql FROM sqlite_master").fetchall()
    except sqlite3.DatabaseError:
        raise RecordingError(f"'{path.name}' is not a recording, or its beginning is damaged") from None
    finally:
        connection.close()
    for kind, name, sql in rows:
        plain = kind == "index" and sql is None
        if kind == "table" and isinstance(sql, str):
            plain = re.fullmatch(r"CREATE TABLE \w+ \([\w\s,()]*\)", sql) is not None and not re.search(
                r"\b(AS|CHECK|DEFAULT|GENERATED|REFERENCES|COLLATE|CONFLICT)\b", sql.upper()
            )
        if not plain:
            raise RecordingError(
                f"recording '{path.name}' holds the {kind!s:.20} '{name!s:.40}', which no recording does"
            )


def _allow_processor_time(seconds: float) -> None:
    spent = resource.getrusage(resource.RUSAGE_SELF)
    until = int(spent.ru_utime + spent.ru_stime + seconds) + 1
    with suppress(ValueError, OSError):
        resource.setrlimit(resource.RLIMIT_CPU, (until, resource.getrlimit(resource.RLIMIT_CPU)[1]))


def _say(answers: IO[str], message: dict[str, Any]) -> None:
    answers.write(json.dumps({**message, "peak_bytes": _peak_bytes()}, allow_nan=False) + "\n")
    answers.flush()


def _peak_bytes() -> int:
    """The most memory that this process has had at once. Not ru_maxrss where it can be helped: that begins with what
    the server had from which all was started, and a large one would replace every reader at once."""
    try:
        for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) * 1024
    except OSError:
        pass
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


if __name__ == "__main__":
    main(int(sys.argv[1]), float(sys.argv[2]))
