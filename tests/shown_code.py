"""Code that texts show: a page's blocks, and a shell's commands as the words that programs are called with."""

from __future__ import annotations

import re
import shlex
import shutil
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
CABINET = ROOT / "sample_data" / "cabinet"

# The files of the sample cabinet, by the names that pages call them.
SAMPLES = {
    "cabinet.urdf": CABINET / "cabinet.urdf",
    "depth.png": CABINET / "open" / "depth.png",
    "camera.json": CABINET / "open" / "camera.json",
    "above.png": CABINET / "from_above" / "depth.png",
    "above.json": CABINET / "from_above" / "camera.json",
    "lowered.png": CABINET / "lowered" / "depth.png",
    "lowered.json": CABINET / "lowered" / "camera.json",
}


def blocks(page: Path) -> list[tuple[str, str]]:
    """Language, empty where none is named, and text of each fenced block of a Markdown page, in order."""
    found = re.findall(r"^```([^\n]*)\n(.*?)^```$", page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    return [(language, text) for language, text in found]


def with_samples(folder: Path) -> Path:
    """The folder, with copies of SAMPLES in it."""
    for name, source in SAMPLES.items():
        shutil.copyfile(source, folder / name)
    return folder


def commands(text: str) -> Iterator[list[str]]:
    """Each command of `text` by its words, without comments; lines that end with a backslash go on in the next one.

    Left out are settings of variables, empty lines, and where what is printed goes; what a command in it would print is
    the word 1.
    """
    for line in re.sub(r"\$\([^)]*\)", "1", text.replace("\\\n", " ")).splitlines():
        words: list[str] = []
        for word in [*shlex.split(line, comments=True), "&&"]:
            if word != "&&":
                words.append(word)
                continue
            if ">" in words:
                words = words[: words.index(">")]
            while words and re.match(r"[A-Z_]+=", words[0]):
                words = words[1:]
            if words:
                yield words
            words = []
