"""Is a manifest read as it stands, and are all of its rows that cannot be used told, with their places, and at once?"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pmpnbp.batch.manifest import read_manifest
from pmpnbp.batch.row import MEMBERS, OPTIONS
from pmpnbp.errors import ManifestError
from tests.batch.manifests import csv_file, files, json_lines

GOOD = {"model": "m.urdf", "scan": "a.pcd"}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return files(tmp_path, "m.urdf", "a.pcd", "b/a.pcd", "d.png", "e.png", "c.json", "p.json")


def refused(path: Path) -> str:
    with pytest.raises(ManifestError) as caught:
        read_manifest(path)
    return str(caught.value)


def test_csv_and_json_lines_say_the_same(folder: Path) -> None:
    (folder / "roi.json").write_text('{"roi": [0, 0, 0, 1, 1, 1]}')
    rows: list[dict[str, Any]] = [
        GOOD | {"name": "first", "seed": 7, "roi": [0, -1, 0, 1, 1, 1.5]},
        {"model": "m.urdf", "scans": ["d.png", "e.png"], "camera": ["c.json", "c.json"], "prior": "p.json"},
        {"model": "m.urdf", "scan": "d.png", "camera": "c.json", "roi": "roi.json", "particles": 50, "max_std": 0.01},
        GOOD | {"scan": "b/a.pcd", "config": {"image_width": "80", "renderer": "splats"}},
    ]
    columns = ["name", "model", "scan", "scans", "camera", "roi", "prior", "particles", "seed", "max_std", "config"]
    table = csv_file(
        folder / "m.csv",
        columns,
        ["first", "m.urdf", "a.pcd", "", "", "0,-1,0,1,1,1.5", "", "", "7", "", ""],
        ["", "m.urdf", "", "d.png; e.png", "c.json;c.json", "", "p.json", "", "", "", ""],
        ["", "m.urdf", "d.png", "", "c.json", "roi.json", "", "50", "", "0.01", ""],
        ["", "m.urdf", "b/a.pcd", "", "", "", "", "", "", "", "image_width=80; renderer=splats"],
    )
    found = read_manifest(table)
    assert found == read_manifest(json_lines(folder / "m.jsonl", *rows))
    assert [row.name for row in found] == ["first", "d", "d_2", "b_a"]
    assert (found[0].roi, found[0].options) == ((0, -1, 0, 1, 1, 1.5), {"seed": 7})
    assert found[1].scans == (folder / "d.png", folder / "e.png") and len(found[1].cameras) == 2
    assert found[2].roi == (0, 0, 0, 1, 1, 1) and found[2].options == {"particles": 50, "max_std": 0.01}
    assert found[3].settings == {"image_width": "80", "renderer": "splats"}


def test_what_spreadsheets_write_is_read(folder: Path) -> None:
    wanted = read_manifest(csv_file(folder / "plain.csv", ["model", "scan", "roi"], ["m.urdf", "a.pcd", "0 0 0 1 1 1"]))
    for text in (
        "\ufeffmodel,scan,roi\r\nm.urdf,a.pcd,0 0 0 1 1 1\r\n",
        "\n\nmodel;scan;roi;\nm.urdf;a.pcd;0 0 0 1 1 1;\n;;;\n",
        'model\tscan\troi\n m.urdf \t"a.pcd"\t[0, 0, 0, 1, 1, 1]',
        "model,scan,roi\n\n,,\nm.urdf,a.pcd,0;0;0;1;1;1\n",
    ):
        (folder / "m.csv").write_text(text, encoding="utf-8", newline="")
        assert read_manifest(folder / "m.csv") == wanted


def test_priors_and_cameras_may_stand_in_json_lines(folder: Path) -> None:
    (row,) = read_manifest(
        json_lines(folder / "m.jsonl", GOOD | {"camera": {"width": 3}, "prior": {"kind": "uniform"}})
    )
    assert (row.cameras, row.prior) == (({"width": 3},), {"kind": "uniform"})


def test_what_a_row_does_not_say_is_given_for_all(folder: Path) -> None:
    path = json_lines(folder / "m.jsonl", GOOD, GOOD | {"seed": 2, "prior": None})
    rows = read_manifest(path, {"seed": 1, "prior": str(folder / "p.json")})
    assert [row.options for row in rows] == [{"seed": 1}, {"seed": 2}]
    assert [row.prior for row in rows] == [folder / "p.json"] * 2


def test_absolute_paths_are_taken_as_they_are(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    elsewhere = tmp_path_factory.mktemp("elsewhere")
    row = {name: str(folder / value) for name, value in GOOD.items()}
    (found,) = read_manifest(json_lines(elsewhere / "m.jsonl", row))
    assert found.scans == (folder / "a.pcd",)


@pytest.mark.parametrize(
    ("row", "sentence"),
    [
        ({}, "neither 'scan' nor 'scans' is given; expected one of them"),
        (GOOD | {"scans": ["a.pcd"]}, "both 'scan' and 'scans' are given; expected one of them"),
        ({"scan": "a.pcd"}, "no 'model' is given; expected a URDF"),
        (GOOD | {"scna": "a"}, "'scna' is not known; there are name, model, scan"),
        (GOOD | {"model": "gone.urdf"}, "model 'gone.urdf' is not there"),
        (GOOD | {"scan": "b"}, "scan 'b' is a folder; expected a file"),
        (GOOD | {"scan": 3}, "'scan' is 3; expected the path of a file"),
        (GOOD | {"scan": "a\0"}, "scan 'a\\x00' is no"),
        (GOOD | {"scan": "a" * 5000}, "is no path"),
        ({"model": "m.urdf", "scans": "a.pcd"}, "'scans' is 'a.pcd'; expected a list of paths"),
        ({"model": "m.urdf", "scans": []}, "'scans' is []; expected a list of paths"),
        (GOOD | {"scan": "d.png"}, "scan 'd.png' is a depth image and needs a camera; no 'camera' is given"),
        (GOOD | {"camera": ["c.json", "c.json"]}, "2 cameras are given for 1 scans"),
        (GOOD | {"roi": [1, 2, 3]}, "'roi' is [1, 2, 3]; expected six finite numbers x0 y0 z0 x1 y1 z1"),
        (GOOD | {"roi": [0, 0, 0, 1, 1, True]}, "expected six finite numbers"),
        (GOOD | {"roi": [0, 0, 0, 1, 1, 10**400]}, "expected six finite numbers"),
        (GOOD | {"roi": [1, 0, 0, 0, 1, 1]}, "which is empty; expected x0 < x1"),
        (GOOD | {"roi": "c.json"}, "roi file 'c.json' is not JSON"),
        (GOOD | {"prior": "gone.json"}, "prior 'gone.json' is not there"),
        (GOOD | {"seed": "x"}, "setting 'seed' is 'x'; it must be a whole number"),
        (GOOD | {"method": "guess"}, "'guess'; it can be pmpnbp or particle_filter"),
        (GOOD | {"max_std": 0}, "'max_std' is 0; expected metres above zero"),
        (GOOD | {"config": {"speed": 9}}, "setting 'speed' does not exist"),
        (GOOD | {"config": "speed=9"}, "'config' is 'speed=9'; expected settings by name"),
        (GOOD | {"name": "../x"}, "name '../x' can be no file's"),
        (GOOD | {"name": "é" * 101}, "can be no file's"),
        (GOOD | {"name": "a\nb"}, "has the character U+000A"),
        (GOOD | {"name": 3}, "'name' is 3; expected text"),
    ],
)
def test_a_row_that_cannot_be_used_is_told(folder: Path, row: dict[str, Any], sentence: str) -> None:
    said = refused(json_lines(folder / "m.jsonl", GOOD, row))
    assert said.startswith("manifest 'm.jsonl', line 2: ") and sentence in said and "\n" not in said


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", "'m.csv' names no estimates; expected a row for each"),
        ("model,scan\n", "names no estimates"),
        ("a picture", "the header of manifest 'm.csv' has a column 'a picture'; there are name, model"),
        ("scan,scan\n", "has the column 'scan' twice"),
        ("model,scan\nm.urdf\n", "line 2: it has 1 fields; expected 2"),
        ("model,scan\nm.urdf,a.pcd,x\n", "line 2: it has 3 fields; expected 2"),
        ("model,scan,\nm.urdf,a.pcd,x\n", "line 2: 'x' stands in a column without a name"),
        ('model,scan\n"m.urdf,a.pcd\n', "line 2: it is no row of a CSV file (unexpected end of data)"),
        ("model,scan\nm.urdf," + "a" * 200_000, "line 2: it is no row of a CSV file (field larger than"),
        ('model,scan\n"m\n.urdf",a.pcd\nx,a.pcd', "line 2: model 'm\\n.urdf' is not there\nmanifest 'm.csv', line 4: "),
        ("model,scan,roi\nm.urdf,a.pcd,here\n", "line 2: 'roi' is 'here'; expected x0 y0 z0 x1 y1 z1"),
        ("model,scan,roi\nm.urdf,a.pcd,nan 0 0 1 1 1\n", "expected six finite numbers"),
        ("model,scan,config\nm.urdf,a.pcd,fast\n", "'config' is 'fast'; expected NAME=VALUE"),
        ("[{}]", "line 1: it is '[{}]'; expected an object {…}"),
        ("{\n}", "line 1: it is not JSON"),
        ('{"name": "\\ud800"}', "line 1: it holds half of a surrogate pair"),
        ('{"a":' * 50_000, "line 1: it is not JSON (nested too deep)"),
    ],
)
def test_text_that_is_no_manifest_is_told(folder: Path, text: str, sentence: str) -> None:
    (folder / "m.csv").write_text(text, encoding="utf-8", newline="")
    assert sentence in refused(folder / "m.csv")


def test_files_that_are_none_are_told(folder: Path) -> None:
    assert refused(folder / "no.csv") == (
        "manifest 'no.csv' is not there; expected a CSV or JSON lines file, or a folder"
    )
    (folder / "m.csv").write_bytes(b"\xff\xfe\x00")
    assert "is not UTF-8 text" in refused(folder / "m.csv")


def test_all_rows_are_told_at_once_the_first_by_name(folder: Path) -> None:
    bad = [GOOD | {"scan": f"{number}.pcd"} for number in range(8)]
    lines = refused(json_lines(folder / "m.jsonl", *bad)).splitlines()
    assert lines[:2] == [
        "manifest 'm.jsonl', line 1: scan '0.pcd' is not there",
        "manifest 'm.jsonl', line 2: scan '1.pcd' is not there",
    ]
    assert len(lines) == 6 and lines[-1] == "and 3 more rows cannot be used"


def test_names_are_told_apart(folder: Path) -> None:
    path = json_lines(folder / "m.jsonl", GOOD | {"name": "One"}, GOOD | {"name": "oNE"})
    assert refused(path).endswith("line 2: name 'oNE' is taken by manifest 'm.jsonl', line 1")
    rows = read_manifest(json_lines(folder / "m.jsonl", GOOD, GOOD, GOOD | {"scan": "b/../a.pcd"}))
    assert [row.name for row in rows] == ["a", "a_2", "b_.._a"]


def test_a_folder_of_scenes(tmp_path: Path) -> None:
    folder = files(
        tmp_path / "scenes",
        *("m.urdf", "one/depth.png", "one/camera.json", "one/color.png", "two/cloud.pcd", "two/own.zip"),
        *("three/x.npy", "three/camera.json", "three/prior.json", "meshes/a.ply", "meshes/scene.txt", ".git/depth.png"),
    )
    (folder / "one" / "roi.json").write_text('{"roi": [0, 0, 0, 1, 1, 1]}')
    one, three, two = read_manifest(folder)
    assert [row.name for row in (one, two, three)] == ["one", "two", "three"]
    assert one.scans == (folder / "one" / "depth.png",) and one.cameras == (folder / "one" / "camera.json",)
    assert (one.roi, one.prior) == ((0, 0, 0, 1, 1, 1), None)
    assert (two.cameras, two.model.name, three.model.name) == ((), "own.zip", "m.urdf")
    assert three.prior == folder / "three" / "prior.json"


def test_folders_of_which_none_can_be_made_are_told(tmp_path: Path) -> None:
    folder = files(tmp_path / "s", "a/camera.json", "b/depth.png", "b/scan.pcd", "c/cloud.pcd", "d/depth.png")
    assert refused(folder).splitlines() == [
        "scene 'a' of folder 's': it has a camera.json and no scan; "
        "expected one of .png, .npy, .npz, .pcd, .ply, .xyz, .txt",
        "scene 'b' of folder 's': it holds 2 scans, 'depth.png', 'scan.pcd'; "
        "expected one, or a manifest that names them",
        "scene 'c' of folder 's': no 'model' is given; expected a URDF, or a zip that holds one",
        "scene 'd' of folder 's': no 'model' is given; expected a URDF, or a zip that holds one",
    ]
    assert "names no estimates; expected a folder with a scan for each" in refused(files(tmp_path / "e", "x/y.txt"))


VALUES = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.floats(),
    st.text(max_size=5),
    st.sampled_from(["m.urdf", "a.pcd", "d.png", "c.json", "b", ".", "0 0 0 1 1 1", "image_width=80", "0", "pmpnbp"]),
)
MEMBER = st.sampled_from([*MEMBERS, *OPTIONS, "other"])


@pytest.fixture(scope="module")
def rubbish(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return files(tmp_path_factory.mktemp("rubbish"), "m.urdf", "a.pcd", "d.png", "c.json", "b/x")


def told_or_read(path: Path) -> None:
    try:
        rows = read_manifest(path)
    except ManifestError as error:
        assert 1 <= len(str(error).splitlines()) <= 6
    else:
        assert rows and len({row.name.casefold() for row in rows}) == len(rows)


@given(
    rows=st.lists(
        st.dictionaries(MEMBER, st.one_of(VALUES, st.lists(VALUES, max_size=6), st.dictionaries(MEMBER, VALUES))),
        max_size=3,
    )
)
def test_rubbish_in_json_lines_is_told_or_read(rubbish: Path, rows: list[dict[str, Any]]) -> None:
    path = rubbish / "m.jsonl"
    path.write_text("".join(json.dumps({**GOOD, **row}) + "\n" for row in rows), encoding="utf-8")
    told_or_read(path)


@given(header=st.lists(MEMBER, max_size=6), rows=st.lists(st.lists(VALUES.map(str), max_size=6), max_size=3))
def test_rubbish_in_csv_is_told_or_read(rubbish: Path, header: list[str], rows: list[list[str]]) -> None:
    text = ",".join(["model", "scan", *header])
    lines = [",".join(["m.urdf", "a.pcd", *row]) for row in rows]
    (rubbish / "m.csv").write_text("\n".join([text, *lines]), encoding="utf-8", errors="replace", newline="")
    told_or_read(rubbish / "m.csv")


@given(content=st.binary(max_size=60))
def test_any_bytes_are_told_or_read(rubbish: Path, content: bytes) -> None:
    for head in (b"", b"model,scan\n", b'{"model": "m.urdf", "scan": '):
        (rubbish / "any.csv").write_bytes(head + content)
        told_or_read(rubbish / "any.csv")
