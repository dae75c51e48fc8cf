"""`pmpnbp batch` from its manifest to the report: is each result what `estimate` gives, is nothing lost or made twice,
and does it go on where it was stopped?"""

from __future__ import annotations

import csv
import json
import multiprocessing
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

from app.cli import main
from pmpnbp.batch import run as run_module
from pmpnbp.batch.manifest import read_manifest
from pmpnbp.batch.run import batch
from pmpnbp.batch.work import pack, perform
from pmpnbp.runs.run_log import NAME, RunLog
from tests.app.command_line import CABINET, SCAN, Capture, refused
from tests.app.small_sessions import QUICK
from tests.batch.manifests import hold, json_lines, told_at_once
from tests.reproduce.example_runs import run_here

SMALL = {"model": str(CABINET / "cabinet.urdf"), "particles": 40, "iterations": 4, "config": QUICK}
OPTIONS = [word for name, value in QUICK.items() for word in ("--config", f"{name}={value}")]


def row(scene: str, **members: Any) -> dict[str, Any]:
    files = {"scan": "depth.png", "camera": "camera.json", "roi": "roi.json", "prior": "prior.json"}
    return SMALL | {name: str(CABINET / scene / file) for name, file in files.items()} | members


def rows_of(out: Path) -> dict[str, dict[str, str]]:
    with (out / "table.csv").open(newline="", encoding="utf-8") as file:
        return {row["name"]: row for row in csv.DictReader(file)}


def lines_of(out: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (out / NAME).read_text().splitlines()[1:]]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The folder of a batch, with a row that comes to nothing, and one of two views."""
    folder = tmp_path_factory.mktemp("batch")
    (folder / "cut.png").write_bytes((CABINET / "open" / "depth.png").read_bytes()[:500])
    views = {
        name: [str(CABINET / scene / file) for scene in ("self_occluded", "second_view")]
        for name, file in (("scans", "depth.png"), ("camera", "camera.json"))
    }
    two = {name: value for name, value in row("self_occluded").items() if name != "scan"} | views
    manifest = json_lines(
        folder / "m.jsonl",
        row("open", name="<b>open & #1"),
        row("open", name="cut", scan="cut.png"),
        two | {"name": "two views", "seed": 3},
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run_module, "spread", run_here)
        assert main(["batch", str(manifest), "--out", str(folder / "out"), "--quiet"]) == 2
    yield folder


def test_results_are_those_of_estimate(made: Path, tmp_path: Path) -> None:
    one = tmp_path / "one.json"
    scenes = (CABINET / "self_occluded", CABINET / "second_view")
    views = [str(scene / "depth.png") for scene in scenes]
    cameras = [word for scene in scenes for word in ("--camera", str(scene / "camera.json"))]
    box = ",".join(map(str, json.loads((scenes[0] / "roi.json").read_text())["roi"]))
    asked = ["--roi", box, "--prior", str(scenes[0] / "prior.json"), "--particles", "40", "--iterations", "4"]
    arguments = ["estimate", SMALL["model"], *views, *cameras, *asked, "--seed", "3", *OPTIONS, "--quiet"]
    assert main([*arguments, "--out", str(one)]) == 0
    found, alone = (json.loads(path.read_text()) for path in (made / "out" / "results" / "two views.json", one))
    assert found.pop("seconds") > 0 and alone.pop("seconds") > 0
    assert found == alone


def test_rows_that_come_to_nothing_are_told_and_stop_nothing(made: Path) -> None:
    table = rows_of(made / "out")
    assert list(table) == ["<b>open & #1", "cut", "two views"]
    assert table["cut"]["error"] == "scan 'cut.png' is not a PNG that can be read, or is cut short"
    assert table["cut"]["verdict"] == "error" and not table["cut"]["slide1 position"]
    assert sorted(path.name for path in (made / "out" / "results").iterdir()) == ["<b>open & #1.json", "two views.json"]
    result = json.loads((made / "out" / "results" / "two views.json").read_text())
    told = table["two views"]
    assert (float(told["slide1 position"]), int(told["links"])) == (result["joints"]["slide1"]["position"], 7)
    assert float(told["seconds"]) == result["seconds"] and told["error"] == ""


def test_pictures_lie_beside_the_report(made: Path) -> None:
    with Image.open(made / "out" / "pictures" / "<b>open & #1.png") as picture:
        assert picture.size == (480, 360)
    report = (made / "out" / "report.html").read_text()
    assert 'src="pictures/%3Cb%3Eopen%20%26%20%231.png"' in report and "<b>open" not in report


def test_going_on_makes_what_is_left_and_what_has_changed(
    made: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    """In an order of its own: each call goes on from where the one before has left it."""
    monkeypatch.setattr(run_module, "spread", run_here)
    out = made / "out"
    before = (out / "results" / "two views.json").stat().st_mtime_ns
    again = ["batch", str(made / "m.jsonl"), "--out", str(out), "--quiet"]
    assert main(again) == 2  # the one that came to nothing is tried again
    assert capsys.readouterr().err.startswith("pmpnbp batch: 1 of 3 rows came to nothing, the first, 'cut': scan")
    assert [line["asked"]["name"] for line in lines_of(out)] == ["<b>open & #1", "cut", "two views", "cut"]
    (made / "cut.png").write_bytes((CABINET / "open" / "depth.png").read_bytes())
    (out / "results" / "<b>open & #1.json").unlink()
    assert main(again) == 0
    assert [line["asked"]["name"] for line in lines_of(out)][4:] == ["<b>open & #1", "cut"]
    assert (out / "results" / "two views.json").stat().st_mtime_ns == before
    monkeypatch.setattr(run_module, "spread", lambda *_: pytest.fail("nothing is left to be made"))
    assert main(again) == 0
    # a result that is damaged is none
    (out / "results" / "two views.json").write_text("{")
    left: list[str] = []
    monkeypatch.setattr(run_module, "spread", lambda _, works, *__: left.extend(one.name for one in works) or iter(()))
    main(again)
    assert left == ["two views"]
    # an option, or what is in a file, makes another row of it; what it gave before is no result of it
    monkeypatch.setattr(run_module, "spread", run_here)
    (made / "cut.png").write_bytes(b"")
    assert main([*again, "--max-std", "0.01"]) == 2
    assert len(lines_of(out)) == 9
    assert not (out / "results" / "cut.json").exists() and not (out / "pictures" / "cut.png").exists()
    assert rows_of(out)["two views"]["verdict"] in ("found", "certain", "doubtful", "not found", "no verdict")


def test_inputs_travel_with_the_row(tmp_path: Path) -> None:
    """Nothing of this machine's disk is needed where the estimate is made."""
    files = {"camera": "camera.json", "scan": "depth.png", "roi": "roi.json", "prior": "prior.json"}
    for file in files.values():
        (tmp_path / file).write_bytes((CABINET / "open" / file).read_bytes())
    (tmp_path / "cabinet.urdf").write_bytes((CABINET / "cabinet.urdf").read_bytes())
    (one,) = read_manifest(json_lines(tmp_path / "m.jsonl", SMALL | files | {"model": "cabinet.urdf"}))
    work = pack(one)
    for path in tmp_path.iterdir():
        path.unlink()
    outcome = perform(work)
    assert outcome.error is None and outcome.result is not None and outcome.result["model"] == "cabinet"


def test_a_model_that_cannot_be_used_is_told_as_estimate_does(tmp_path: Path, capsys: Capture) -> None:
    (tmp_path / "m.urdf").write_text("<robot")
    (one,) = read_manifest(json_lines(tmp_path / "m.jsonl", row("open", model="m.urdf")))
    alone = refused(capsys, "estimate", str(one.model), *SCAN[1:], "--quiet")
    assert alone == f"pmpnbp estimate: {perform(pack(one)).error}\n"


def test_an_interruption_keeps_what_is_made_and_says_how_to_go_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    manifest = json_lines(tmp_path / "m.jsonl", row("open", name="a"), row("open", name="b"))

    def interrupted(*arguments: Any) -> Iterator[Any]:
        yield next(run_here(*arguments))
        raise KeyboardInterrupt

    monkeypatch.setattr(run_module, "spread", interrupted)
    out = tmp_path / "out"
    assert main(["batch", str(manifest), "--out", str(out), "--quiet"]) == 130
    assert capsys.readouterr().err == (
        f"pmpnbp batch: interrupted; 1 of 2 rows are kept in '{out}', and the same command goes on from there\n"
    )
    assert {name: told["verdict"] == "waiting" for name, told in rows_of(out).items()} == {"a": False, "b": True}
    monkeypatch.setattr(run_module, "spread", run_here)
    assert main(["batch", str(manifest), "--out", str(out), "--quiet"]) == 0
    assert [line["asked"]["name"] for line in lines_of(out)] == ["a", "b"]


def test_a_worker_that_is_killed_takes_no_row_with_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run_module, "perform", told_at_once)
    rows = read_manifest(json_lines(tmp_path / "m.jsonl", *(row("open", seed=seed) for seed in range(20))))
    told: list[str] = []

    def on_row(name: str, error: str | None) -> None:
        told.append(name)
        if len(told) == 2:
            multiprocessing.active_children()[0].kill()

    made = batch(rows, tmp_path / "out", processes=2, on_row=on_row)
    assert made.first_error is None and sum(made.counts.values()) == 20
    names = sorted(row.name for row in rows)
    assert sorted(told) == names
    assert sorted(line["asked"]["name"] for line in lines_of(tmp_path / "out")) == names
    assert len({json.loads(path.read_text())["seed"] for path in (tmp_path / "out" / "results").iterdir()}) == 20


def test_two_batches_are_not_made_in_one_folder_at_once(tmp_path: Path, capsys: Capture) -> None:
    """The lock is another process's: its own would be granted again."""
    manifest = json_lines(tmp_path / "m.jsonl", row("open"))
    out = tmp_path / "out"
    out.mkdir()
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    holder = context.Process(target=hold, args=(out / ".lock", there))
    holder.start()
    here.recv()
    try:
        said = refused(capsys, "batch", str(manifest), "--out", str(out), "--quiet")
        assert said == (f"pmpnbp batch: another batch is being made in '{out}'; name another folder with --out\n")
    finally:
        here.send("enough")
        holder.join()


def test_bad_input_is_told_before_anything_is_written(tmp_path: Path, capsys: Capture) -> None:
    out = tmp_path / "out"
    manifest = json_lines(tmp_path / "m.jsonl", row("open", scan="gone.pcd"))
    options = ["--out", str(out), "--quiet"]
    assert "line 1: scan 'gone.pcd' is not there" in refused(capsys, "batch", str(manifest), *options)
    json_lines(tmp_path / "m.jsonl", row("open"))
    for words, sentence in (
        (["--prior", "gone.json"], "prior file 'gone.json' is not there"),
        (["--config", "speed=3"], "setting 'speed' does not exist"),
        (["--roi", "1,0,0,0,1,1"], "'roi' is [1.0, 0.0, 0.0, 0.0, 1.0, 1.0], which is empty"),
        (["--processes", "0"], "'0' is not a whole number from 1 to 256"),
    ):
        given = json_lines(tmp_path / "n.jsonl", {name: value for name, value in row("open").items() if name != "roi"})
        assert sentence in refused(capsys, "batch", str(given), *options, *words)
    assert "'gone.csv' is not there; expected a CSV" in refused(capsys, "batch", "gone.csv", *options)
    assert not out.exists()
    out.write_text("mine")
    assert "cannot be written" in refused(capsys, "batch", str(manifest), *options)
    assert out.read_text() == "mine"


def test_results_of_something_else_are_not_mixed_in(tmp_path: Path, capsys: Capture) -> None:
    RunLog(tmp_path / "out", "push")
    manifest = json_lines(tmp_path / "m.jsonl", row("open"))
    said = refused(capsys, "batch", str(manifest), "--out", str(tmp_path / "out"), "--quiet")
    assert "holds runs of push" in said and "this is batch" in said
