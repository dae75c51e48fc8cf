"""Which of the kernels that came with an image does this processor take, and can they be read where they are?

numba finds what it compiled by the name of the processor that it was compiled for, which is the one that it runs on: on
another make everything is compiled again, about a minute. An image cannot know where it will run. Its kernels are
compiled for common targets, which the environment's KERNEL_TARGETS names, best first, and each start takes the first of
them that the processor fits. Where that variable is not set, numba compiles for the very processor that there is.
"""

from __future__ import annotations

import atexit
import os
import shutil
import tempfile
from collections.abc import Mapping, MutableMapping
from pathlib import Path

from pmpnbp.errors import SettingError

VARIABLE = "KERNEL_TARGETS"
# The name of the thread that compiles them as a server starts.
WARM_UP = "warm-up"
CPUINFO = Path("/proc/cpuinfo")
# What a target takes for granted, in the words of /proc/cpuinfo (x86-64 psABI; "abm" there is LZCNT, "pni" SSE3).
# "generic" is what every 64-bit ARM has: a processor without its word is none.
NEEDS = {
    "x86-64-v3": "avx avx2 bmi1 bmi2 f16c fma abm movbe",
    "x86-64-v2": "cx16 lahf_lm pni popcnt sse4_1 sse4_2 ssse3",
    "generic": "asimd",
}


def choose(environment: MutableMapping[str, str] = os.environ) -> None:
    """Have numba, which must not have been imported yet, use the kernels of the best target; what the environment says
    of the processor already stays. Raises SettingError for an unknown target, or if there is no room for a copy."""
    fitting = targets(environment)
    if fitting and "NUMBA_CPU_NAME" not in environment:
        environment.update(for_target(fitting[0]))
    if VARIABLE in environment and environment.get("NUMBA_CACHE_DIR"):
        environment["NUMBA_CACHE_DIR"] = _writable(environment["NUMBA_CACHE_DIR"])


def targets(environment: Mapping[str, str] = os.environ) -> list[str]:
    """Those of KERNEL_TARGETS that this processor fits, in their order. Raises SettingError for an unknown one."""
    named = environment.get(VARIABLE, "").split()
    for name in named:
        if name not in NEEDS:
            raise SettingError(f"{VARIABLE} names '{name}', which is no target; there are {', '.join(NEEDS)}")
    found = _instructions()
    return [name for name in named if found.issuperset(NEEDS[name].split())]


def for_target(name: str) -> dict[str, str]:
    """The environment variables that make numba compile for a target, and find what it compiled."""
    return {"NUMBA_CPU_NAME": name, "NUMBA_CPU_FEATURES": ""}


def _instructions() -> set[str]:
    """What the first processor can do, as Linux tells it; nothing elsewhere."""
    if CPUINFO.is_file():
        for line in CPUINFO.read_text(encoding="utf-8", errors="replace").splitlines():
            name, _, words = line.partition(":")
            if name.strip() in ("flags", "Features"):
                return set(words.split())
    return set()


def _writable(folder: str) -> str:
    """The folder, or a copy of it until this process ends: numba passes over one that it cannot write, full or not."""
    if os.access(folder, os.W_OK) or not os.access(folder, os.R_OK):
        return folder
    try:
        copy = tempfile.mkdtemp(prefix="kernels-")
        atexit.register(shutil.rmtree, copy, ignore_errors=True)
        shutil.copytree(folder, copy, dirs_exist_ok=True)
        _open_up(Path(copy))
    except (OSError, shutil.Error) as error:
        raise SettingError(
            f"the compiled kernels in '{folder}', which cannot be written, find no room in a temporary folder either: "
            f"{error}"
        ) from None
    return copy


def _open_up(copy: Path) -> None:
    """Let its owner write a copy of folders that nobody may write."""
    for path in (copy, *copy.rglob("*")):
        path.chmod(path.stat().st_mode | 0o200)
