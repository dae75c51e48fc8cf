"""Does what is dropped on the start page become an estimate without a number typed: files, a region, run?"""

from __future__ import annotations

import json
import re
import zipfile
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Page, expect

from tests.app import small_sessions as small
from tests.browser.conftest import PATIENCE
from tests.browser.session_page import opened, view, wait
from tests.browser.start_page import URDF, arrived, emptied
from tests.servers import Served

__all__ = ["emptied"]  # a fixture of every test here
expect.set_options(timeout=PATIENCE)
ARM, ROBOT = small.CABINET / "arm", small.CABINET.parent / "robot"
# What sorting.js makes of files { path: text }, with a 16 bit and an 8 bit PNG by their names.
SORTED = """async (texts) => {
  const { sorted } = await import("/static/files/sorting.js");
  const png = (bits, colour) => Uint8Array.from([...Array(24).fill(0), bits, colour]);
  const file = (path, text) => new File([path.endsWith(".png") ? png(...text) : text], path.split("/").pop());
  const found = await sorted(Object.entries(texts).map(([path, text]) => ({ path, file: file(path, text) })));
  return {
    ...found,
    uploads: found.uploads.map(({ kind, path, file, camera }) => [kind, path, file.name, camera ?? null]),
  };
}"""
DEPTH16, PHOTO = [16, 0], [8, 2]


def test_files_dropped_together_are_found_where_the_box_is_clicked(page: Page, served: Served) -> None:
    page.goto(served.url)
    page.get_by_label("Choose files").set_input_files([URDF, ARM / "depth.png", ARM / "camera.json"])
    path = f"/api/v1/sessions/{arrived(page)}"
    panel = page.get_by_role("region", name="2 things stand here: which one?")
    first, other = (panel.get_by_role("button", name=re.compile("high")).nth(place) for place in (0, 1))
    expect(first).to_have_attribute("aria-pressed", "true")
    expect(first).to_contain_text("most like the model")
    proposed = [one["roi"] for one in served.client.get(f"{path}/regions").json()["regions"]]
    wait(page, lambda: view(page, served)["proposals"] == proposed)
    other.click()
    wait(page, lambda: view(page, served)["region"] == proposed[1])
    # what a click in the scene does, the page hears of
    served.client.patch(f"{path}/views/{_view_name(page)}", json={"region": proposed[0]})
    expect(first).to_have_attribute("aria-pressed", "true")
    panel.get_by_role("button", name="Run", exact=True).click()
    expect(panel).to_have_count(0)
    expect(page.locator("#certain")).to_contain_text("Found:")
    found = small.at_rest(served.client, path)
    assert (found["roi"], found["until"], found["fit"]) == (proposed[0], "converged", "good")
    layers = view(page, served)["show"]
    assert layers["estimate"] and not layers["region"] and view(page, served)["proposals"] == []


def test_a_box_is_drawn_by_hand_and_the_model_is_laid_into_it(page: Page, served: Served) -> None:
    session = small.create(served.client, roi=None)
    opened(page, served, session, "?setup")
    panel = page.locator("#setup")
    panel.get_by_role("button", name="anywhere in the scan").click()
    expect(panel.get_by_role("button", name="anywhere in the scan")).to_have_attribute("aria-pressed", "true")
    panel.get_by_text("Advanced").click()
    expect(panel.get_by_text("The box in world.")).to_be_hidden()
    panel.get_by_role("button", name="Draw a box by hand").click()
    expect(panel.get_by_text("The box in world.")).to_be_visible()
    panel.get_by_label("largest z of the region").fill("80")
    panel.get_by_label("largest z of the region").press("Tab")
    own = panel.get_by_role("button", name="my own box")
    expect(own).to_have_attribute("aria-pressed", "true")
    panel.get_by_role("switch", name="I know roughly how it stands").check()
    wait(page, lambda: view(page, served)["prior"] is not None)
    panel.get_by_label("seed").fill("7")
    panel.get_by_role("button", name="Run", exact=True).click()
    expect(panel).to_be_hidden()
    found = served.client.get(session).json()
    assert found["roi"][5] == 0.8 and found["seed"] == 7 and found["prior"]["kind"] == "gaussian"
    assert found["prior"]["std_xyz"] == [0.08] * 3

    # a session that has run is set up anew from its page; a box with nothing in it is refused, and nothing has changed
    small.at_rest(served.client, session)
    page.get_by_role("button", name="Set up").click()
    expect(panel.get_by_role("button", name="this session’s box")).to_have_attribute("aria-pressed", "true")
    page.get_by_role("button", name="Close without running").click()
    expect(panel).to_be_hidden()
    page.get_by_role("button", name="Set up").click()
    panel.get_by_label("seed").press("Escape")
    expect(panel).to_be_hidden()
    expect(page.get_by_role("button", name="Set up")).to_be_focused()
    assert served.client.get(session).json()["roi"] == found["roi"]


def test_a_page_loaded_again_is_where_it_was(page: Page, served: Served) -> None:
    session = small.create(served.client, roi=None)
    panel, own = page.locator("#setup"), page.get_by_role("button", name="my own box")
    opened(page, served, session, "?setup")
    expect(panel.get_by_role("button", name="most like the model")).to_have_attribute("aria-pressed", "true")
    panel.get_by_text("Advanced").click()
    panel.get_by_label("largest z of the region").fill("80")
    panel.get_by_label("largest z of the region").press("Tab")
    expect(own).to_have_attribute("aria-pressed", "true")
    wait(page, lambda: (view(page, served)["region"] or [0.0])[-1] == 0.8)
    opened(page, served, session)
    expect(own).to_have_attribute("aria-pressed", "true")
    panel.get_by_role("button", name="Close without running").click()
    wait(page, lambda: view(page, served)["show"]["estimate"])
    page.reload()
    expect(page.get_by_role("button", name="Set up")).to_be_visible()
    expect(panel).to_be_hidden()
    # what is run meanwhile is shown as it was before the set-up
    page.get_by_role("button", name="Set up").click()
    wait(page, lambda: not view(page, served)["show"]["estimate"])
    page.goto("about:blank")
    served.client.post(f"{session}/run", json={"iterations": 500})
    opened(page, served, session)
    wait(page, lambda: view(page, served)["show"]["estimate"])
    expect(panel).to_be_hidden()


def test_another_view_is_added_before_the_run(page: Page, served: Served) -> None:
    scan = small.upload_scan(served.client, "from_above")
    session = small.create(served.client, scan_id=scan, roi=None)
    opened(page, served, session, "?setup")
    choices = page.get_by_role("list", name="Regions").get_by_role("button")
    expect(choices.first).to_contain_text("most like the model")
    before = choices.first.text_content() or ""
    lowered = small.CABINET / "lowered"
    page.get_by_label("Add another view of the scene").set_input_files([lowered / "depth.png", lowered / "camera.json"])
    wait(page, lambda: len(served.client.get(session).json()["scan_ids"]) == 2)
    expect(choices.first).not_to_have_text(before)  # two views show more of it


@pytest.mark.parametrize("packed", [False, True])
def test_a_folder_and_a_zip_bring_model_meshes_scan_and_camera(
    page: Page, served: Served, tmp_path: Path, packed: bool
) -> None:
    folder = tmp_path / "robot"
    files = {path: (ROBOT / path).read_bytes() for path in ("robot.urdf", "meshes/head.obj")}
    files |= {
        f"scan_0/{name}": (ROBOT / "scan_0" / name).read_bytes() for name in ("depth.png", "camera.json", "truth.json")
    }
    for path, content in files.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_bytes(content)
    page.goto(served.url)
    if packed:
        with zipfile.ZipFile(tmp_path / "robot.zip", "w", zipfile.ZIP_DEFLATED) as archive:
            for path, content in files.items():
                archive.writestr(path, content)
        page.get_by_label("Choose files").set_input_files(tmp_path / "robot.zip")
    else:
        page.get_by_label("Choose a folder").set_input_files(folder)
    path = f"/api/v1/sessions/{arrived(page)}"
    expect(page.locator("#setup-choices").get_by_text("most like the model")).to_be_visible()
    found = served.client.get(path).json()
    (scan,) = served.client.get("/api/v1/scans").json()
    given = json.loads(files["scan_0/camera.json"])
    assert found["scan_ids"] == [scan["id"]] and found["roi"] is None
    assert scan["camera"]["T_world_camera"] == pytest.approx(given["T_world_camera"])
    (model,) = served.client.get("/api/v1/models").json()
    assert model["name"] == "mobile_manipulator" or model["links"]


def test_files_are_told_apart_and_paired(page: Page, served: Served) -> None:
    page.goto(served.url)

    def sorted_(texts: dict[str, Any]) -> dict[str, Any]:
        found: dict[str, Any] = page.evaluate(SORTED, texts)
        return found

    camera = {name: json.dumps({"fx": number}) for number, name in enumerate(("a", "b", "c"))}
    # each its own: by the name, by what is left of it, in its own folder
    found = sorted_(
        {
            "a.png": DEPTH16,
            "a.json": camera["a"],
            "all/depth_7.png": DEPTH16,
            "all/camera_7.json": camera["b"],
            "all/camera_8.json": camera["c"],
            "view/depth.png": DEPTH16,
            "view/camera.json": camera["c"],
        }
    )
    assert [(path, text) for _, path, _, text in found["uploads"]] == [
        ("a.png", camera["a"]),
        ("all/depth_7.png", camera["b"]),
        ("view/depth.png", camera["c"]),
    ]
    # one for all, from folders beside each other; and none where it is not clear which
    found = sorted_({"s/depth/1.png": DEPTH16, "s/depth/2.png": DEPTH16, "s/camera.json": camera["a"]})
    assert [text for *_, text in found["uploads"]] == [camera["a"]] * 2
    found = sorted_({"depth/3.png": DEPTH16, "camera/3.json": camera["a"], "camera/4.json": camera["b"]})
    assert [text for *_, text in found["uploads"]] == [camera["a"]]
    found = sorted_({"one.pcd": "", "camera_3.json": camera["a"], "camera_4.json": camera["b"]})
    assert [text for *_, text in found["uploads"]] == [None]
    # meshes go with the model that names them, textures are no scans, and what lies about is left
    urdf = '<robot><mesh filename="package://it/meshes/base.ply"/></robot>'
    found = sorted_(
        {"it/it.urdf": urdf, "it/meshes/base.ply": "ply", "it/wood.png": PHOTO, "it/readme.md": "", "it/.DS_Store": ""}
    )
    assert [(kind, name) for kind, _, name, _ in found["uploads"]] == [("models", "it.zip")] and not found["refused"]
    found = sorted_({"p.json": '{"kind": "uniform"}', "roi.json": '{"roi": [0, 0, 0, 1, 1, 1]}', "x.json": "{"})
    assert (found["priors"], found["regions"]) == (['{"kind": "uniform"}'], [[0, 0, 0, 1, 1, 1]])
    assert found["refused"] == [["x.json", "'x.json' is not JSON."]]


def _view_name(page: Page) -> str:
    return (page.locator("#scene").get_attribute("src") or "").split("/")[4]
