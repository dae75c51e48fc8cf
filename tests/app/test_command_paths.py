"""Paths on the command line that lead to no plain file: links, pipes, devices, what is locked or can be no path."""

from __future__ import annotations

import errno
import json
import os
import shutil
import stat
import threading
from pathlib import Path
from typing import Any

import pytest

from app.cli import main
from pmpnbp.recording import Recording
from tests.app.command_line import CABINET, CAMERA, DEPTH, MODEL, SCAN, Capture, refused

START = ["estimate", *SCAN, "--iterations", "0", "--particles", "40", "--quiet"]
LONG = "x" * 300


def lock(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Make the folder one that may not be looked into, for the superuser as well."""
    known = os.stat

    def refusing(path: Any, *words: Any, **named: Any) -> os.stat_result:
        if str(path).startswith(f"{folder}/"):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))
        return known(path, *words, **named)

    monkeypatch.setattr(os, "stat", refusing)


def test_the_result_goes_where_a_link_leads(tmp_path: Path) -> None:
    out, target = tmp_path / "link.json", tmp_path / "target.json"
    target.write_text("old")
    out.symlink_to(target.name)
    assert main([*START, "--out", str(out)]) == 0
    assert out.is_symlink() and json.loads(target.read_text())["iteration"] == 0


def test_the_result_goes_into_a_pipe(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    read: list[str] = []
    reader = threading.Thread(target=lambda: read.append(pipe.read_text()), daemon=True)
    reader.start()
    assert main([*START, "--out", str(pipe)]) == 0
    reader.join(10)
    assert pipe.is_fifo() and json.loads(read[0])["iteration"] == 0


def test_a_device_stays_one(tmp_path: Path, capsys: Capture) -> None:
    device = tmp_path / "null"
    try:
        os.mknod(device, stat.S_IFCHR | 0o666, os.makedev(1, 3))
    except PermissionError:
        pytest.skip("only a superuser makes devices")
    assert main([*START, "--out", str(device)]) == 0
    assert "is there and is no file" in refused(capsys, *START, "--recording", str(device))
    assert device.is_char_device()


def test_a_recording_is_not_put_in_place_of_a_pipe(tmp_path: Path, capsys: Capture) -> None:
    os.mkfifo(tmp_path / "pipe")
    said = refused(capsys, *START, "--recording", str(tmp_path / "pipe"))
    assert said == ("pmpnbp estimate: 'pipe' is there and is no file; expected a new name, or an old recording\n")
    assert (tmp_path / "pipe").is_fifo()


def test_a_recording_goes_where_a_link_leads(tmp_path: Path, capsys: Capture) -> None:
    (tmp_path / "link").symlink_to("target")
    for _ in range(2):
        assert main([*START, "--recording", str(tmp_path / "link")]) == 0
        assert (tmp_path / "link").is_symlink()
        with Recording(tmp_path / "target") as recording:
            assert recording.iterations() == [0]


@pytest.mark.parametrize("option", ["--out", "--recording", "--draws"])
def test_an_output_does_not_replace_an_input(option: str, tmp_path: Path, capsys: Capture) -> None:
    inputs = {}
    for what, path in (
        ("model", MODEL),
        ("scan", DEPTH),
        ("camera file", CAMERA),
        ("prior file", str(CABINET / "prior.json")),
        ("truth file", str(CABINET / "open" / "truth.json")),
    ):
        inputs[what] = shutil.copy(path, tmp_path)
    model, scan, camera, prior, truth = inputs.values()
    words = ["estimate", model, scan, "--camera", camera, "--prior", prior, "--truth", truth]
    (tmp_path / "link").symlink_to(Path(scan).name)
    for what, path in [*inputs.items(), ("scan", str(tmp_path / "link"))]:
        before = Path(path).read_bytes()
        said = refused(capsys, *words, option, path)
        name = Path(inputs[what]).name
        assert said == f"pmpnbp estimate: {option} would replace the {what} '{name}'; expected another file\n"
        assert Path(path).read_bytes() == before


def test_two_outputs_are_not_one_file_by_a_link(tmp_path: Path, capsys: Capture) -> None:
    (tmp_path / "link").symlink_to("both")
    said = refused(capsys, *START, "--out", str(tmp_path / "both"), "--recording", str(tmp_path / "link"))
    assert "--out and --recording are both 'both'; expected two files" in said


def test_what_may_not_be_looked_at_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture) -> None:
    lock(tmp_path, monkeypatch)
    it = str(tmp_path / "it.png")
    for words, what in (
        (["estimate", it, DEPTH], "model 'it.png' cannot be read"),
        (["estimate", MODEL, it], "scan 'it.png' cannot be read"),
        (["estimate", MODEL, DEPTH, "--camera", it], "camera file 'it.png' cannot be read"),
        ([*START, "--prior", it], "prior file 'it.png' cannot be read"),
        ([*START, "--out", it], f"--out '{it}' cannot be written"),
        ([*START, "--recording", it], f"--recording '{it}' cannot be written"),
        (["view", it, "--no-browser"], f"recording '{it}' cannot be read"),
        (["calibrate", it], "model 'it.png' cannot be read"),
        (["calibrate", MODEL, "--camera", it], "camera file 'it.png' cannot be read"),
        (["batch", it], "manifest 'it.png' cannot be read"),
        (["batch", str(CABINET), "--model", it], "model 'it.png' cannot be read"),
    ):
        assert refused(capsys, *words).endswith(f"{what}: Permission denied\n"), words


def test_what_is_too_long_to_be_a_name_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    monkeypatch.chdir(tmp_path)
    cut = f"'{LONG[:60]}…'"
    for words, what in (
        (["estimate", LONG, DEPTH], f"model {cut} cannot be read"),
        (["estimate", MODEL, LONG], f"scan {cut} cannot be read"),
        (["estimate", MODEL, DEPTH, "--camera", LONG], f"camera file {cut} cannot be read"),
        ([*START, "--prior", LONG], f"prior file {cut} cannot be read"),
        ([*START, "--out", LONG], f"--out '{LONG}' cannot be written"),
        (["view", LONG, "--no-browser"], f"recording '{LONG}' cannot be read"),
        (["calibrate", LONG], f"model {cut} cannot be read"),
        (["batch", LONG], f"manifest {cut} cannot be read"),
    ):
        assert refused(capsys, *words).endswith(f"{what}: File name too long\n"), words


def test_a_result_may_have_as_long_a_name_as_a_file_can(tmp_path: Path) -> None:
    out = tmp_path / (250 * "n" + ".json")
    assert main([*START, "--out", str(out)]) == 0
    assert json.loads(out.read_text())["iteration"] == 0


def test_what_has_no_end_is_not_read_to_it(tmp_path: Path, capsys: Capture) -> None:
    (tmp_path / "x.png").symlink_to("/dev/zero")
    for words, what in (
        ([*SCAN[:2], "--camera", "/dev/zero"], "camera file 'zero' is larger than 1048576 bytes"),
        ([*SCAN, "--prior", "/dev/zero"], "prior file 'zero' is larger than 1048576 bytes"),
        ([MODEL, str(tmp_path / "x.png"), "--camera", CAMERA], "scan 'x.png' is a pipe or a device; expected a file"),
        (["/dev/zero", DEPTH], "model 'zero' is a pipe or a device, expected a URDF file"),
    ):
        assert what in refused(capsys, "estimate", *words, "--quiet")
    assert "manifest 'zero' is larger than 256 MiB" in refused(capsys, "batch", "/dev/zero", "--quiet")


def test_a_camera_may_come_through_a_pipe(tmp_path: Path, capsys: Capture) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    writer = threading.Thread(target=pipe.write_bytes, args=(Path(CAMERA).read_bytes(),), daemon=True)
    writer.start()
    assert main(["estimate", MODEL, DEPTH, "--camera", str(pipe), *START[5:]]) == 0
    assert json.loads(capsys.readouterr().out)["iteration"] == 0


def test_a_recording_that_may_not_be_read_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    path = tmp_path / "r.sqlite"
    path.write_bytes(b"SQLite format 3\0")
    known = Path.open

    def refusing(it: Path, *words: Any, **named: Any) -> Any:  # as of a user who may not, also for the superuser
        if it == path:
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))
        return known(it, *words, **named)

    monkeypatch.setattr(Path, "open", refusing)
    said = refused(capsys, "view", str(path), "--no-browser")
    assert said == f"pmpnbp view: recording '{path}' cannot be read: Permission denied\n"
