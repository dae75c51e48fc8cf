"""Ten attacks that once took the server, its memory or its lists away, against a server that runs.

    python -m tests.app.attacks http://127.0.0.1:8080 [--token TOKEN] [--only text --only bomb] [--pid PID] [--log FILE]

Each is a caller's over the network, and removes what it made. Memory is read from the system where the server's process
is named by `--pid`, else from /metrics. Two attacks that harm whatever they are made on (a kill, folders removed), and
parts of others that need certain settings, start servers of their own. The exit status is 1 where any is broken.
"""

from __future__ import annotations

import argparse
import os
import resource
import sys
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from tests.app.attacks import (
    bodies,
    cookies,
    fair_shares,
    kills,
    manners,
    poisoned_text,
    recording_bomb,
    removed,
    silent_sockets,
    slashes,
)
from tests.app.attacks.outcome import Outcome
from tests.app.attacks.target import Target
from tests.app.attacks.watch import faults, log_size

ATTACKS: Mapping[str, tuple[str, Callable[[Target, Outcome], None]]] = {
    "text": ("1 poisoned text", poisoned_text.attack),
    "bomb": ("2 recording bombs", recording_bomb.attack),
    "bodies": ("3 large and deep bodies", bodies.attack),
    "silent": ("4 silent sockets", silent_sockets.attack),
    "shares": ("5 fair shares", fair_shares.attack),
    "cookies": ("6 cookies of two servers", cookies.attack),
    "kills": ("7 all or nothing at a kill", kills.attack),
    "slashes": ("8 names with a slash", slashes.attack),
    "removed": ("9 removed underfoot", removed.attack),
    "manners": ("10 manners of HTTP", manners.attack),
}


def main(words: Sequence[str] | None = None) -> int:
    """Attack as the command line says."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.app.attacks", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("url")
    parser.add_argument("--token")
    parser.add_argument("--only", action="append", choices=list(ATTACKS), help="may be given more than once")
    parser.add_argument("--pid", type=int, help="of the server's process, where it is on this machine")
    parser.add_argument("--log", type=Path, help="file of the server's messages; default: what the process writes to")
    arguments = parser.parse_args(words)
    _many_files()
    log = arguments.log or _standard_error(arguments.pid)
    broken = []
    for key in arguments.only or ATTACKS:
        target = Target(arguments.url.rstrip("/"), arguments.token, arguments.pid, log)
        outcome = attack(key, target)
        print(outcome, flush=True)
        if outcome.broken:
            broken.append(outcome.name)
    print(f"{len(arguments.only or ATTACKS) - len(broken)} held, {len(broken)} broken: {', '.join(broken) or 'none'}")
    return int(bool(broken))


def attack(key: str, target: Target) -> Outcome:
    """One attack; what it made is removed, whatever comes of it."""
    name, act = ATTACKS[key]
    outcome = Outcome(name)
    began, log = time.monotonic(), log_size(target)
    try:
        act(target, outcome)
    except Exception as error:
        where = traceback.extract_tb(error.__traceback__)[-1]
        outcome.broken.append(
            f"the attack could not go on: {type(error).__name__}: {error} ({Path(where.filename).name}:{where.lineno})"
        )
    finally:
        target.clean()
    outcome.happened += [f"its log: {count} × {told}" for told, count in faults(target, log).most_common(10)]
    outcome.happened.append(f"took {time.monotonic() - began:.0f} s")
    return outcome


def _many_files() -> None:
    """As many connections as the system lets us have."""
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))


def _standard_error(pid: int | None) -> Path | None:
    """The file to which a process writes its messages; None where it is no file."""
    try:
        path = None if pid is None else Path(os.readlink(f"/proc/{pid}/fd/2"))
    except OSError:
        return None
    return path if path is not None and path.is_file() else None


if __name__ == "__main__":
    sys.exit(main())
