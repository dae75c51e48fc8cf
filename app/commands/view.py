"""`pmpnbp view`: a recording in the page, by a server of its own that keeps nothing."""

from __future__ import annotations

import argparse
import logging
import os
import shutil
import sqlite3
import sys
import tempfile
import threading
import webbrowser
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from stat import S_ISREG
from urllib.parse import quote

from fastapi import FastAPI

from app.commands.serve import link, say, serve
from app.problems import HttpProblem
from app.server_config import ServerConfig
from app.store.store import Store
from app.uploads.parsers import Parsers
from pmpnbp.errors import RecordingError
from pmpnbp.files import status

# A recording of one's own may take longer to read than a stranger's upload: hours of iterations.
READING_SECONDS = 600.0


def run(arguments: argparse.Namespace) -> int:
    """Serve the recording until SIGTERM or SIGINT; return the exit status. Raises PmpnbpError for a bad file."""
    recording: Path = arguments.recording
    found = status(recording, f"recording '{recording}'", RecordingError)
    if found is None or not S_ISREG(found.st_mode):
        what = "is not there" if found is None else "is no file"
        raise RecordingError(f"recording '{recording}' {what}; expected what `pmpnbp estimate --recording` writes")
    try:
        recording.open("rb").close()
    except OSError as error:
        raise RecordingError(f"recording '{recording}' cannot be read: {error.strerror}") from None
    with tempfile.TemporaryDirectory(prefix="pmpnbp-view-") as folder:
        config = ServerConfig(port=arguments.port or 0, data_dir=Path(folder))

        def opened(app: FastAPI, config: ServerConfig) -> Callable[[], None]:
            id = take_in(recording, app.state.store, config)
            page = f"{link(config)}sessions/{id}/"
            return lambda: _show(page, arguments.browser)

        return serve(config, logging.WARNING, opened)


def take_in(recording: Path, store: Store, config: ServerConfig) -> str:
    """The id of the entry that `recording` becomes in `store`; the file itself stays as it is. Raises RecordingError.

    It is read once, as an upload is, by a process that a hostile file may crash.
    """
    parsers = Parsers(config.parse_bytes, READING_SECONDS)
    try:
        with store.staging() as staging:
            staged = staging.folder / recording.name
            _linked_or_copied(recording, staged)
            summary = parsers.parse("recordings", staged, staging.folder / "out")
            return str(store.add("recordings", staged, recording.name, summary)["id"])
    except HttpProblem as problem:
        raise RecordingError(problem.detail) from None
    except OSError as error:
        raise RecordingError(f"recording '{recording}' cannot be read: {error.strerror}") from None
    finally:
        parsers.close()


def _linked_or_copied(source: Path, target: Path) -> None:
    if source.with_name(source.name + "-wal").exists():
        # still being written, or cut off: its newest iterations are in the log beside it
        try:
            address = f"file:{quote(str(source.absolute()))}?mode=ro"
            with closing(sqlite3.connect(address, uri=True)) as old, closing(sqlite3.connect(target)) as new:
                old.backup(new)
            return
        except sqlite3.DatabaseError:
            target.unlink(missing_ok=True)
    else:
        try:
            os.link(source.resolve(), target)
            return
        except OSError:
            pass  # another file system, or one that knows no links
    shutil.copyfile(source, target)


def _show(page: str, browser: bool) -> None:
    """Say where the page is, and open it where there is a screen: a browser in a terminal could not show it."""
    say(page)
    screen = sys.platform in ("darwin", "win32") or any(
        os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER")
    )
    if browser and screen:
        # beside the server, which has to answer what the browser asks
        threading.Thread(target=webbrowser.open, args=(page,), name="browser", daemon=True).start()
