"""Does what a page hands out work elsewhere: its files, its commands, its marks, and a recording that was cut short?"""

from __future__ import annotations

import io
import json
import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Locator, Page, expect

from tests.app import small_sessions as small
from tests.browser.conftest import PATIENCE, Troubles, pixels
from tests.browser.session_page import opened, tab, view, wait
from tests.servers import Served

expect.set_options(timeout=PATIENCE)


@pytest.fixture
def session(served: Served) -> str:
    """The path of a session that has made six iterations."""
    return small.after(served.client, 6, name="a cabinet", max_std=0.03)


@pytest.mark.scene
def test_the_scene_is_a_file_that_needs_no_server(
    page: Page, new_page: Callable[..., Page], served: Served, session: str, tmp_path: Path, troubles: Troubles
) -> None:
    troubles.expect("GPU stall")
    page = opened(page, served, session)
    wait(page, lambda: view(page, served)["drawn"] is not None)
    panel = tab(page, "Share")
    with page.expect_download() as download:
        panel.get_by_role("link", name="3D scene").click()
    assert download.value.suggested_filename == f"{session.rsplit('/', 1)[1]}-6.html"
    file = tmp_path / "scene.html"
    download.value.save_as(file)

    alone = new_page(offline=True)
    asked: list[str] = []
    alone.on("request", lambda request: asked.append(request.url))
    alone.goto(file.as_uri())
    alone.locator("canvas").first.wait_for()
    wait(alone, lambda: float(pixels(alone).std()) > 5)
    assert [url for url in asked if not url.startswith(("file:", "data:", "blob:"))] == []
    assert asked[0] == file.as_uri()


def test_picture_and_estimate_are_those_of_the_iteration(page: Page, served: Served, session: str) -> None:
    page = opened(page, served, session)
    page.get_by_role("slider", name="Iteration").fill("4")
    panel = tab(page, "Share")
    picture = panel.get_by_role("link", name="Picture")
    expect(picture).to_have_attribute("href", re.compile("iteration=4"))
    kept = {}
    for name in ("Picture", "Estimate", "Recording"):
        with page.expect_download() as download:
            panel.get_by_role("link", name=name).click()
        kept[name] = Path(download.value.path()).read_bytes()
    shown = np.asarray(Image.open(io.BytesIO(kept["Picture"])).convert("RGB"))
    assert shown.shape == (480, 640, 3) and shown.std() > 20  # as large as the scan, at most
    first, wanted = (served.client.get(f"{session}/estimate.png?iteration={k}&width=1280").content for k in (0, 4))
    assert kept["Picture"] == wanted != first
    assert json.loads(kept["Estimate"]) == served.client.get(f"{session}/estimate?iteration=4").json()
    made = served.client.post("/api/v1/recordings", files={"file": ("kept.sqlite", kept["Recording"])})
    assert made.status_code == 201 and made.json()["last_iteration"] == 6


@pytest.mark.skipif(shutil.which("curl") is None, reason="curl is not installed")
def test_the_copied_commands_run(page: Page, served: Served, session: str) -> None:
    page.context.grant_permissions(["clipboard-read", "clipboard-write"])
    opened(page, served, session)
    page.get_by_role("slider", name="Iteration").fill("5")
    page.get_by_role("button", name="between frame and drawer2").click()
    panel = tab(page, "Why")
    panel.get_by_role("button", name="drawer2", exact=True).click()
    panel.get_by_role("list").locator("[data-part=drawer2]").first.click()
    wait(page, lambda: view(page, served)["particle"] is not None)
    state = view(page, served)
    panel = tab(page, "Share")
    expect(panel.locator("#share-curl")).to_contain_text(f"particles/{state['particle']}")
    panel.get_by_role("button", name="Copy").last.click()
    expect(panel.get_by_role("button", name="Copied")).to_be_visible()
    copied = page.evaluate("navigator.clipboard.readText()")
    assert copied == panel.locator("#share-curl").inner_text()

    answers = {}
    what = ""
    for line in copied.splitlines():
        if line.startswith("# "):
            what = line[2:]
            continue
        made = subprocess.run(["bash", "-c", f"{line} --silent --show-error"], capture_output=True, check=True)
        answers[what] = json.loads(made.stdout)
    estimate = served.client.get(f"{session}/estimate?iteration=5").json()
    assert answers["the estimate"] == estimate
    why = answers["why this particle weighs what it does"]
    assert (why["part"], why["index"], why["iteration"]) == ("drawer2", state["particle"], 5)
    shown = answers["this 3D view shows it"]
    assert (shown["iteration"], shown["part"], shown["particle"]) == (5, "drawer2", state["particle"])


@pytest.mark.scene
def test_marks_tell_where_a_part_became_certain_and_settings_changed(page: Page, served: Served, session: str) -> None:
    changed = served.client.patch(session, json={"config": {"effective_share": 0.2}})
    assert changed.status_code == 200
    served.client.post(f"{session}/run", json={"until": "converged"}).raise_for_status()
    last = small.at_rest(served.client, session)["iteration"]
    page = opened(page, served, session)
    graph, trace = (served.client.get(f"{session}/{name}").json() for name in ("graph", "trace"))
    *before, rest = trace["iterations"]
    assert rest["certain"]  # else this shows nothing
    assert not any(row["std_xyz"] for row in before)  # the belief's width is no uncertainty before the end
    expect(page.locator(".mark.certain")).to_have_count(len(graph["parts"]))
    for part in graph["parts"]:
        mark = page.get_by_title(f"{part['name']} is certain from iteration {last} on")
        assert place(mark) == pytest.approx(1, abs=1e-6)
    change = page.locator(".mark.change")
    expect(change).to_have_count(1)
    expect(change).to_have_attribute("title", re.compile("after iteration 6 .*effective_share = 0.2"))
    assert place(change) == pytest.approx(6 / last, abs=1e-6)
    change.click()
    expect(page.locator("#shown")).to_have_text(re.compile(rf"6 / {last}$"))
    wait(page, lambda: (view(page, served)["drawn"] or {}).get("iteration") == 6)


def test_a_part_is_marked_as_certain_though_others_are_not(page: Page, served: Served, session: str) -> None:
    path = f"{session}/trace"
    trace = served.client.get(path).json()
    *_, last = trace["iterations"]
    links = last["particle_std_xyz"]
    last |= {"std_xyz": links, "certain_by_link": {link: link in ("drawer1", "handle1", "handle2") for link in links}}
    page.route(f"**{path}?*", lambda route: route.fulfill(json=trace))
    opened(page, served, session)
    mark = page.locator(".mark.certain")  # of drawer2 one of two links alone is
    expect(mark).to_have_count(1)
    expect(mark).to_have_attribute("title", f"drawer1 is certain from iteration {last['iteration']} on")


def test_a_mark_tells_what_the_inference_remarked(page: Page, served: Served) -> None:
    config = small.QUICK | {"search_explained": 1.0, "search_restarts": 1}
    session = small.after(served.client, 4, config=config)
    (note,) = [note for row in served.client.get(f"{session}/trace").json()["iterations"] for note in row["notes"]]
    page = opened(page, served, session)
    mark = page.get_by_title(f"iteration 2: {note}")
    expect(mark).to_have_count(1)
    assert place(mark) == pytest.approx(2 / 4, abs=1e-6)


@pytest.mark.scene
def test_a_recording_that_was_cut_short(page: Page, served: Served, session: str) -> None:
    content = served.client.get(f"{session}/recording").content
    cut = content[: int(len(content) * 0.9)]
    made = served.client.post("/api/v1/recordings", files={"file": ("cut.sqlite", cut)}).json()
    newest = made["last_iteration"]
    assert 0 < newest < 6
    page.goto(f"{served.url}/sessions/{made['id']}/")
    page.locator("body[data-ready]").wait_for()
    expect(page.locator("#state-word")).to_have_text("recording")
    expect(page.locator("#shown")).to_have_text(f"{newest} / {newest}")
    expect(page.get_by_role("alert").first).to_contain_text(f"what comes after iteration {newest} is damaged")
    expect(page.locator("#part-rows tr")).to_have_count(4)
    wait(page, lambda: (view(page, served)["drawn"] or {}).get("iteration") == newest)
    page.get_by_role("slider", name="Iteration").fill("0")
    wait(page, lambda: view(page, served)["drawn"]["iteration"] == 0)


def place(mark: Locator) -> float:
    """Share of the timeline's length, from the left."""
    return float(mark.evaluate("(mark) => mark.style.getPropertyValue('--at')"))
