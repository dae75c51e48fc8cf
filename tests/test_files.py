"""Files that a user names: what is read of them, and how they come to be written, wherever the path leads."""

from __future__ import annotations

import os
import threading
from pathlib import Path

import pytest

from pmpnbp.errors import PmpnbpError, RecordingError, ScanError
from pmpnbp.files import is_file, quoted, read_file, status, written_whole
from pmpnbp.library.playback import Playback
from pmpnbp.recording import Recording


def test_no_more_is_read_than_the_limit_whatever_the_size_is_said_to_be(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(b"12345")
    assert read_file(path, "a", 5, ScanError) == b"12345"
    with pytest.raises(ScanError, match=r"^a is larger than 4 bytes$"):
        read_file(path, "a", 4, ScanError, beyond="4 bytes")
    with pytest.raises(ScanError, match=r"^a is larger than 3 MiB$"):
        read_file(Path("/dev/zero"), "a", 3 << 20, ScanError, streams=True)
    with pytest.raises(ScanError, match=r"^a is a pipe or a device; expected a file$"):
        read_file(Path("/dev/zero"), "a", 3 << 20, ScanError)


def test_a_pipe_is_read_to_its_end_where_it_may_be_one(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    with pytest.raises(ScanError, match="is a pipe or a device"):
        read_file(pipe, "it", 10, ScanError)
    content = b"x" * 300_000  # more than a pipe holds
    writer = threading.Thread(target=pipe.write_bytes, args=(content,))
    writer.start()
    assert read_file(pipe, "it", 1 << 20, ScanError, streams=True) == content
    writer.join()


@pytest.mark.parametrize(
    ("path", "reason"),
    [
        ("x" * 300, "File name too long"),
        ("a\0b", "its path has a NUL in it"),
        ("circle", "Too many levels of symbolic"),
    ],
)
def test_what_can_be_no_path_is_a_sentence(path: str, reason: str, tmp_path: Path) -> None:
    (tmp_path / "circle").symlink_to("circle")
    for call in (
        lambda: status(tmp_path / path, "it", ScanError),
        lambda: read_file(tmp_path / path, "it", 1, ScanError),
    ):
        with pytest.raises(ScanError, match=f"it cannot be read: {reason}"):
            call()


def test_what_is_not_there() -> None:
    for gone in (Path("gone"), Path(__file__) / "below a file"):
        assert status(gone, "it", PmpnbpError) is None


def test_a_file_is_no_folder_pipe_or_device(tmp_path: Path) -> None:
    file, link, pipe = tmp_path / "file", tmp_path / "link", tmp_path / "pipe"
    file.touch()
    link.symlink_to(file)
    os.mkfifo(pipe)
    found = [is_file(one, "it", RecordingError) for one in (file, link, pipe, tmp_path, tmp_path / "none")]
    assert found == [True, True, False, False, False]


def test_a_recording_by_a_name_that_is_no_path_is_told_in_a_sentence(tmp_path: Path) -> None:
    long = tmp_path / ("x" * 300)
    for opened in (Recording, Playback):
        with pytest.raises(RecordingError, match=r"^recording 'x{60}…' cannot be read: File name too long$"):
            opened(long)
        os.mkfifo(pipe := tmp_path / opened.__name__)
        with pytest.raises(RecordingError, match=f"^recording '{opened.__name__}' is not there$"):
            opened(pipe)


def test_a_name_is_quoted_on_one_line_and_cut() -> None:
    assert quoted(Path("a/ä b.png")) == "'ä b.png'"
    assert quoted(Path("two\nlines")) == r"'two\nlines'"
    assert quoted(Path("x" * 300)) == f"'{'x' * 60}…'"


def write(path: Path, text: str) -> None:
    with written_whole(path) as partial:
        partial.write_text(text)


def test_a_file_appears_whole_or_not_at_all(tmp_path: Path) -> None:
    path = tmp_path / ("n" * 251 + ".txt")
    write(path, "first")
    write(path, "second")
    with pytest.raises(ZeroDivisionError), written_whole(path) as partial:
        partial.write_text("half of the third")
        raise ZeroDivisionError
    with pytest.raises(ZeroDivisionError), written_whole(path):
        raise ZeroDivisionError
    assert path.read_text() == "second"
    assert list(tmp_path.iterdir()) == [path]


def test_a_link_stays_and_what_it_leads_to_is_written(tmp_path: Path) -> None:
    for name, target in (("one", "there"), ("two", "new")):
        (tmp_path / name).symlink_to(target)
    (tmp_path / "there").write_text("old")
    for name, target in (("one", "there"), ("two", "new")):
        write(tmp_path / name, "text")
        assert (tmp_path / name).is_symlink() and (tmp_path / target).read_text() == "text"


def test_a_pipe_is_written_into(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    read: list[str] = []
    reader = threading.Thread(target=lambda: read.append(pipe.read_text()))
    reader.start()
    write(pipe, "text")
    reader.join()
    assert read == ["text"] and pipe.is_fifo() and list(tmp_path.iterdir()) == [pipe]
