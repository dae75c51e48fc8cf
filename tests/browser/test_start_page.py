"""Does the start page show what is kept, and make sessions, as a person would: by clicking, typing and dropping?"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from playwright.sync_api import Locator, Page, expect

from tests.app import small_sessions as small
from tests.browser.conftest import DESK, PATIENCE, PHONE, Troubles, pixels, scrolls_sideways
from tests.servers import Served

SCENE = small.CABINET / "open"
URDF, DEPTH, CAMERA = small.CABINET / "cabinet.urdf", SCENE / "depth.png", SCENE / "camera.json"
expect.set_options(timeout=PATIENCE)


@pytest.fixture(autouse=True)
def emptied(served: Served) -> Iterator[None]:
    """Nothing is kept when a test begins."""
    yield
    for kind in ("sessions", "recordings", "models", "scans"):
        for entry in served.client.get(f"/api/v1/{kind}").json():
            served.client.delete(f"/api/v1/{kind}/{entry['id']}")


def card(page: Page, name: str) -> Locator:
    return page.get_by_role("listitem").filter(has=page.get_by_role("link", name=name))


def sessions(served: Served) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = served.client.get("/api/v1/sessions").json()
    return found


def arrived(page: Page) -> str:
    """The id of the session whose page was gone to."""
    page.wait_for_url(re.compile(r"/sessions/[0-9a-f]{16}/"))
    found = re.search(r"/sessions/([0-9a-f]{16})/", page.url)
    assert found
    return found[1]


def contrast(page: Page, selector: str) -> float:
    """Of the text against what is behind it, as the web's accessibility guidelines measure it."""
    colours = page.locator(selector).first.evaluate(
        """(element) => {
          let ground = element;
          while (getComputedStyle(ground).backgroundColor === "rgba(0, 0, 0, 0)") ground = ground.parentElement;
          return [getComputedStyle(element).color, getComputedStyle(ground).backgroundColor];
        }"""
    )
    light = []
    for colour in colours:
        channels = np.array([float(number) for number in re.findall(r"[\d.]+", colour)[:3]]) / 255
        linear = np.where(channels <= 0.04045, channels / 12.92, ((channels + 0.055) / 1.055) ** 2.4)
        light.append(float(linear @ [0.2126, 0.7152, 0.0722]))
    return (max(light) + 0.05) / (min(light) + 0.05)


def test_a_session_is_shown_with_its_picture(page: Page, served: Served) -> None:
    path = small.after(served.client, 2, name="the kitchen's cabinet")
    page.goto(served.url)
    shown = card(page, "the kitchen's cabinet")
    expect(shown.locator(".word")).to_have_text("paused")
    expect(shown.locator(".iteration")).to_have_text("2 of 2")
    expect(shown.locator(".certain")).to_have_text(re.compile("certain"))
    expect(shown.locator(".method")).to_have_text("belief propagation")
    expect(page.get_by_role("status").first).to_have_text("1 kept, 0 iterating")
    expect(shown.get_by_role("link")).to_have_attribute("href", served.client.get(path).json()["view_url"])
    picture = shown.get_by_role("img", name="drawn over its scan")
    picture.wait_for()
    seen = pixels(picture).reshape(-1, 3).astype(float)
    # greys of the scan and the colours of four parts: far from one colour, and far from grey in places
    assert seen.std(axis=0).min() > 10
    assert ((seen.max(axis=1) - seen.min(axis=1)) > 60).mean() > 0.02


def test_the_numbers_of_a_session_that_iterates_change(page: Page, served: Served) -> None:
    path = small.create(served.client, name="busy")
    page.goto(served.url)
    shown = card(page, "busy")
    expect(shown.locator(".word")).to_have_text("paused")
    served.client.post(f"{path}/run", json={"iterations": 100_000})
    expect(shown.locator(".word")).to_have_text("iterating")
    expect(page.get_by_role("status").first).to_have_text("1 kept, 1 iterating")
    first = shown.locator(".iteration").inner_text()
    expect(shown.locator(".iteration")).not_to_have_text(first)
    second = shown.locator(".iteration").inner_text()
    expect(shown.locator(".iteration")).not_to_have_text(second)
    third = shown.locator(".iteration").inner_text()
    numbers = [int(text.split(" of ")[0].replace("\u202f", "")) for text in (first, second, third)]
    assert numbers == sorted(set(numbers))
    served.client.post(f"{path}/pause")
    expect(shown.locator(".word")).to_have_text(re.compile("paused|done"))


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_colours_are_those_that_the_reader_asks_for(
    new_page: Callable[..., Page], served: Served, scheme: str
) -> None:
    small.create(served.client, name="in colour")
    page = new_page(color_scheme=scheme)
    page.goto(served.url)
    card(page, "in colour").wait_for()
    corner = pixels(page)[-1, 0].mean()
    assert corner > 220 if scheme == "light" else corner < 40
    for selector in (
        "h1",
        "#summary",
        ".card .name",
        ".card .word",
        ".card dt",
        ".hint",
        ".drop strong",
        ".button.main",
    ):
        assert contrast(page, selector) >= 4.5, selector


@pytest.mark.parametrize("size", [DESK, PHONE, {"width": 820, "height": 1180}], ids=["desk", "phone", "tablet"])
def test_nothing_is_cut_off_nor_lies_over_something_else(
    new_page: Callable[..., Page], served: Served, size: dict[str, int]
) -> None:
    model_id, scan_id = small.upload_model(served.client), small.upload_scan(served.client)
    for name in ("a", "a session with a rather long name that says where it was, when it was, and why" * 2, "x" * 150):
        path = small.create(served.client, name=name, model_id=model_id, scan_id=scan_id)
    recording = served.client.get(f"{path}/recording").content
    served.client.post("/api/v1/recordings", files={"file": (f"{'long' * 18}.sqlite", recording)})
    page = new_page(viewport=size, has_touch=size is PHONE)
    page.goto(served.url)
    card(page, "xxx").wait_for()
    for summary in page.locator("summary").all():
        summary.click()
    page.get_by_label("about where I say").check()
    assert not scrolls_sideways(page)
    boxes = [
        box.bounding_box()
        for box in page.locator(".card, .entries li, .new, .title h1, .programs").all()
        if box.is_visible()
    ]
    assert len(boxes) > 8
    for place, one in enumerate(boxes):
        assert one is not None and one["x"] >= 0 and one["x"] + one["width"] <= size["width"]
        for other in boxes[:place]:
            assert other is not None
            apart = (
                one["x"] + one["width"] <= other["x"] + 1
                or other["x"] + other["width"] <= one["x"] + 1
                or one["y"] + one["height"] <= other["y"] + 1
                or other["y"] + other["height"] <= one["y"] + 1
            )
            assert apart, (one, other)


def test_the_link_with_the_token_logs_in(
    new_page: Callable[..., Page], serve_for_module: Callable[..., Served], troubles: Troubles
) -> None:
    guarded = serve_for_module(token="a-secret-of-this-test").ready()
    small.create(guarded.client, name="guarded")
    stranger = new_page()
    troubles.expect("401")
    stranger.goto(guarded.url)
    expect(stranger.locator("body")).to_contain_text("a token is needed")
    expect(stranger.locator("body")).to_contain_text("open the link that the server printed")
    assert stranger.get_by_text("guarded").count() == 0

    page = new_page()
    page.goto(f"{guarded.url}/?token=a-secret-of-this-test")
    card(page, "guarded").wait_for()
    assert "token" not in page.url and "a-secret" not in page.content()
    page.get_by_role("img", name="drawn over its scan").wait_for()  # pictures come by the cookie, too
    again = page.context.new_page()
    again.goto(guarded.url)
    card(again, "guarded").wait_for()
    # and what changes something
    again.get_by_role("button", name="Delete the session guarded").click()
    again.get_by_role("dialog").get_by_role("button", name="Delete").click()
    expect(again.locator(".card")).to_have_count(0)
    assert sessions(guarded) == []
    # a page whose cookie is gone says what the server says
    page.context.clear_cookies()
    expect(page.get_by_role("alert").first).to_contain_text("a token is needed")


def test_files_are_chosen_and_become_a_session(page: Page, served: Served) -> None:
    page.goto(served.url)
    expect(page.get_by_text("No session yet")).to_be_visible()
    page.get_by_label("Choose files").set_input_files([DEPTH, CAMERA, URDF])
    uploads = page.get_by_role("list", name="Uploads")
    expect(uploads.get_by_text("7 links, 6 joints, 4 parts")).to_be_visible()
    expect(uploads.get_by_text("300 873 points, 640 × 480")).to_be_visible()
    (model,) = served.client.get("/api/v1/models").json()
    (scan,) = served.client.get("/api/v1/scans").json()
    assert scan["camera"]["T_world_camera"] == pytest.approx(json.loads(CAMERA.read_text())["T_world_camera"])
    expect(page.get_by_label("Model", exact=True)).to_have_value(model["id"])
    expect(page.get_by_role("checkbox", name="depth.png")).to_be_checked()

    page.get_by_label("Name").fill("made by hand")
    page.get_by_label("any orientation").check()
    page.get_by_role("button", name="Bounds of the scans").click()
    expect(page.get_by_label("x from, metres")).to_have_value(f"{scan['bounds'][0]:.3f}")
    for label, number in zip(("x from", "y from", "z from", "x to", "y to", "z to"), small.ROI, strict=True):
        page.get_by_label(f"{label}, metres").fill(str(number))
    page.get_by_text("Inference:").click()
    page.get_by_label("Method").select_option("particle filter")
    page.get_by_label("Preset").select_option("paper")
    page.get_by_label("Particles per part").fill("30")
    page.get_by_label("Iterations", exact=True).fill("12")
    page.get_by_label("Seed").fill("5")
    expect(page.get_by_text("Inference:")).to_contain_text("particle filter, paper, 30 particles, 12 iterations")
    page.get_by_role("button", name="Create session").click()
    id = arrived(page)
    found = served.client.get(f"/api/v1/sessions/{id}").json()
    assert (found["name"], found["model_id"], found["scan_ids"]) == ("made by hand", model["id"], [scan["id"]])
    assert (found["particles"], found["iterations"], found["seed"]) == (30, 12, 5)
    assert found["method"] == "particle_filter" and found["config"] == {"preset": "paper"}
    assert found["roi"] == small.ROI and found["prior"] == {"kind": "uniform", "orientation": "any"}
    page.goto(served.url)
    expect(card(page, "made by hand").locator(".method")).to_have_text("particle filter")


def test_files_are_dropped_wherever_it_is_on_the_page(page: Page, served: Served) -> None:
    page.goto(served.url)
    prior = json.loads((SCENE / "prior.json").read_text())
    texts = {
        "cabinet.urdf": URDF.read_text(),
        "prior.json": json.dumps(prior),
        "roi.json": (SCENE / "roi.json").read_text(),
    }
    carried = page.evaluate_handle(
        """(texts) => {
          const carried = new DataTransfer();
          for (const [name, text] of Object.entries(texts)) carried.items.add(new File([text], name));
          return carried;
        }""",
        texts,
    )
    page.dispatch_event("h1", "dragenter", {"dataTransfer": carried})
    expect(page.locator("#drop")).to_have_attribute("data-over", "")
    page.dispatch_event("h1", "drop", {"dataTransfer": carried})
    expect(page.locator("#drop")).not_to_have_attribute("data-over", "")
    expect(page.get_by_role("list", name="Uploads").get_by_text("7 links, 6 joints, 4 parts")).to_be_visible()
    expect(page.get_by_label("about where I say")).to_be_checked()
    assert json.loads(page.get_by_label("prior.json", exact=True).input_value()) == prior
    expect(page.get_by_label("z to, metres")).to_have_value(str(small.ROI[5]))
    # a scan is missing, and the page says so before the server has to
    page.get_by_role("button", name="Create session").click()
    expect(page.locator("#create-trouble")).to_have_text(re.compile("A scan is missing"))
    scan_id = small.upload_scan(served.client)
    page.reload()
    page.locator(f"input[value='{scan_id}']").check()
    page.get_by_label("about where I say").check()
    page.get_by_label("or from a file").set_input_files(SCENE / "prior.json")
    expect(page.get_by_label("prior.json", exact=True)).to_have_value((SCENE / "prior.json").read_text())
    page.get_by_role("button", name="Create session").click()
    assert served.client.get(f"/api/v1/sessions/{arrived(page)}").json()["prior"]["link"] == prior["link"]


def test_how_far_an_upload_is_can_be_seen(page: Page, served: Served) -> None:
    page.goto(served.url)
    network = page.context.new_cdp_session(page)
    slow = {"offline": False, "latency": 0, "downloadThroughput": -1, "uploadThroughput": 60_000}
    network.send("Network.emulateNetworkConditions", slow)
    page.get_by_label("Choose files").set_input_files([DEPTH, CAMERA])
    bar = page.get_by_role("progressbar", name="Upload of depth.png")
    page.wait_for_function("(bar) => bar.value > 0.05 && bar.value < 0.95", arg=bar.element_handle())
    expect(page.get_by_role("list", name="Uploads")).to_contain_text(re.compile(r"\d+ % of \d+ kB"))
    network.send("Network.emulateNetworkConditions", slow | {"uploadThroughput": -1})
    uploads = page.get_by_role("list", name="Uploads")
    expect(uploads.get_by_text("300 873 points, 640 × 480")).to_be_visible()
    # one that is given up half-way leaves nothing behind, and the next one has its turn
    network.send("Network.emulateNetworkConditions", slow)
    large = {"name": "large.npy", "mimeType": "application/octet-stream", "buffer": bytes(20 << 20)}
    page.get_by_label("Choose files").set_input_files([large])
    page.wait_for_function("(bar) => bar.value > 0", arg=uploads.get_by_role("progressbar").element_handle())
    uploads.get_by_role("button", name="Cancel large.npy").click()
    expect(uploads.get_by_text("large.npy")).to_have_count(0)
    network.send("Network.emulateNetworkConditions", slow | {"uploadThroughput": -1})
    page.get_by_label("Choose files").set_input_files([URDF])
    expect(uploads.get_by_text("7 links, 6 joints, 4 parts")).to_be_visible()
    assert len(served.client.get("/api/v1/scans").json()) == 1


def test_a_wrong_file_is_told_in_the_servers_words(
    page: Page, served: Served, troubles: Troubles, tmp_path: Path
) -> None:
    troubles.expect("422")
    broken = tmp_path / "broken.urdf"
    broken.write_text(URDF.read_text().replace('type="prismatic"', 'type="elastic"', 1))
    said = served.client.post("/api/v1/models", files={"file": (broken.name, broken.read_bytes())}).json()["detail"]
    page.goto(served.url)
    page.get_by_label("Choose files").set_input_files([broken])
    uploads = page.get_by_role("list", name="Uploads")
    expect(uploads.get_by_role("alert").filter(visible=True)).to_have_text(said)
    uploads.get_by_role("button", name="Dismiss broken.urdf").click()
    expect(uploads.get_by_role("listitem")).to_have_count(0)

    # a depth image without its camera; with it, it is taken in
    page.get_by_label("Choose files").set_input_files([DEPTH])
    said = served.client.post("/api/v1/scans", files={"file": (DEPTH.name, DEPTH.read_bytes())}).json()["detail"]
    expect(uploads.get_by_role("alert").filter(visible=True)).to_have_text(said)
    page.get_by_text("Camera for depth images:").click()
    page.get_by_label("camera.json", exact=True).fill(CAMERA.read_text())
    expect(page.get_by_text("Camera for depth images:")).to_contain_text("640 × 480")
    uploads.get_by_role("button", name="Try again").click()
    expect(uploads.get_by_text("300 873 points")).to_be_visible()

    page.get_by_label("Choose files").set_input_files({"name": "notes.md", "mimeType": "text/plain", "buffer": b"#"})
    expect(uploads.get_by_role("alert").filter(visible=True)).to_contain_text("'notes.md' is none of the files")

    # and what makes no session: a box with nothing in it
    small.upload_model(served.client)
    page.reload()
    page.get_by_role("checkbox", name="depth.png").check()
    for label in ("x from", "y from", "z from", "x to", "y to", "z to"):
        page.get_by_label(f"{label}, metres").fill("70")
    asked = {
        "model_id": served.client.get("/api/v1/models").json()[0]["id"],
        "scan_ids": [served.client.get("/api/v1/scans").json()[0]["id"]],
        "roi": [70] * 6,
    }
    said = served.client.post("/api/v1/sessions", json=asked).json()["detail"]
    page.get_by_role("button", name="Create session").click()
    expect(page.locator("#create-trouble")).to_have_text(said)
    page.get_by_label("z to, metres").fill("")
    page.get_by_role("button", name="Create session").click()
    expect(page.locator("#create-trouble")).to_contain_text("5 of its 6 numbers")
    assert sessions(served) == []


def test_a_sample_is_one_click_away(page: Page, served: Served) -> None:
    page.goto(served.url)
    page.get_by_role("button", name="Open a sample session").click()
    id = arrived(page)
    first = served.client.get(f"/api/v1/sessions/{id}").json()
    assert first["name"] == "Sample: a cabinet with an open drawer" and first["roi"] == small.ROI
    served.client.post(f"/api/v1/sessions/{id}/pause")
    assert small.at_rest(served.client, f"/api/v1/sessions/{id}")["iteration"] > 0  # it was set going
    page.goto(served.url)
    page.get_by_label("Sample scene").select_option(label="A cupboard with its door ajar")
    expect(page.get_by_text("One hinge, a revolute joint.")).to_be_visible()
    page.get_by_role("button", name="Open", exact=True).click()
    page.wait_for_url(re.compile("/sessions/(?!" + id + ")[0-9a-f]{16}/"))
    assert [session["name"] for session in sessions(served)][1:] == ["Sample: a cupboard with its door ajar"]


def test_a_recording_is_dropped_and_looked_at(page: Page, served: Served, tmp_path: Path) -> None:
    path = small.after(served.client, 2)
    file = tmp_path / "yesterday.sqlite"
    file.write_bytes(served.client.get(f"{path}/recording").content)
    page.goto(served.url)
    page.get_by_label("Choose files").set_input_files(file)
    id = arrived(page)
    (stored,) = served.client.get("/api/v1/recordings").json()
    assert stored["id"] == id and stored["file_name"] == "yesterday.sqlite"
    page.goto(served.url)
    listed = page.get_by_role("region", name="Recordings").get_by_role("listitem")
    expect(listed).to_contain_text("cabinet, 3 iterations")
    expect(listed).to_contain_text(re.compile(r"\d+ kB|\d\.\d MB"))
    expect(listed.get_by_role("link", name="yesterday.sqlite")).to_have_attribute("href", f"/sessions/{id}/")
    listed.get_by_role("button", name="Delete the recording yesterday.sqlite").click()
    page.get_by_role("dialog").get_by_role("button", name="Delete").click()
    expect(page.get_by_role("region", name="Recordings")).to_have_count(0)
    assert served.client.get("/api/v1/recordings").json() == []


def test_a_session_is_deleted_only_when_that_was_meant(page: Page, served: Served, troubles: Troubles) -> None:
    path = small.create(served.client, name="to go")
    page.goto(served.url)
    button = page.get_by_role("button", name="Delete the session to go")
    dialog = page.get_by_role("dialog", name="Delete this session?")
    button.focus()
    page.keyboard.press("Enter")
    expect(dialog).to_contain_text("“to go” stops after its present iteration")
    expect(dialog.get_by_role("button", name="Keep")).to_be_focused()
    page.keyboard.press("Escape")
    expect(dialog).to_be_hidden()
    expect(button).to_be_focused()
    page.keyboard.press("Enter")
    page.keyboard.press("Enter")  # "Keep"
    expect(dialog).to_be_hidden()
    assert served.client.get(path).status_code == 200
    # its model is in use, and says so
    page.get_by_text("Models and scans").click()
    page.get_by_role("button", name="Delete the model cabinet.urdf").click()
    troubles.expect("409")
    page.get_by_role("dialog").get_by_role("button", name="Delete").click()
    expect(page.locator("#trouble")).to_contain_text("is used by session")
    button.click()
    dialog.get_by_role("button", name="Delete").click()
    expect(page.locator(".card")).to_have_count(0)
    expect(page.get_by_text("No session yet")).to_be_visible()
    assert served.client.get(path).status_code == 404
    page.get_by_role("button", name="Delete the model cabinet.urdf").click()
    page.get_by_role("dialog").get_by_role("button", name="Delete").click()
    expect(page.get_by_role("button", name="Delete the model cabinet.urdf")).to_have_count(0)
    assert served.client.get("/api/v1/models").json() == []


def test_everything_has_a_name_and_can_be_reached_by_keyboard(page: Page, served: Served) -> None:
    small.create(served.client, name="only one")
    page.goto(served.url)
    card(page, "only one").wait_for()
    for summary in page.locator("summary").all():
        summary.click()
    page.get_by_label("about where I say").check()
    nameless = page.evaluate(
        """() => [...document.querySelectorAll("input, select, textarea, button, a[href]")]
          .filter((one) => one.checkVisibility() && !one.ariaLabel && !one.labels?.length && !one.textContent.trim())
          .map((one) => one.outerHTML)"""
    )
    assert nameless == []
    page.locator("body").click(position={"x": 1, "y": 1})
    reached: list[str] = []
    for _ in range(80):
        page.keyboard.press("Tab")
        reached.append(
            page.evaluate(
                "document.activeElement.id || document.activeElement.className || document.activeElement.value"
            )
        )
        outlined = "getComputedStyle(document.activeElement).outlineStyle !== 'none'"
        around = "['.card', '.drop'].some((s) => document.activeElement.closest(s)) || "
        assert page.evaluate(around + outlined) or page.evaluate("document.activeElement === document.body"), reached[
            -1
        ]
    wanted = {
        "open",
        "delete",
        "sample",
        "open-sample",
        "files",
        "camera-text",
        "model",
        "name",
        "prior-text",
        "prior-file",
        "bounds",
        "no-region",
        "method",
        "preset",
        "particles",
        "iterations",
        "seed",
        "button main wide",
    }
    assert wanted <= set(reached)


def test_a_lost_server_is_said_and_comes_back_by_itself(page: Page, served: Served, troubles: Troubles) -> None:
    small.create(served.client, name="still there")
    page.goto(served.url)
    card(page, "still there").wait_for()
    troubles.expect("ERR_FAILED")
    page.route("**/api/v1/sessions", lambda route: route.abort())
    expect(page.locator("#trouble")).to_have_text("The server does not answer; this page tries again.")
    expect(card(page, "still there")).to_be_visible()
    page.unroute("**/api/v1/sessions")
    expect(page.locator("#trouble")).to_be_hidden()


def test_samples_are_listed_and_made_over_rest(served: Served) -> None:
    listed = served.client.get("/api/v1/samples").json()
    assert [sample["scene"] for sample in listed][:2] == ["open", "self_occluded"]
    assert {"from_above", "robot_partial"} < {sample["scene"] for sample in listed}
    client: httpx.Client = served.client
    made = [client.post("/api/v1/sessions/sample", json={"scene": "door", "run": False}) for _ in range(2)]
    assert [answer.status_code for answer in made] == [201, 201]
    assert made[0].headers["location"] == f"/api/v1/sessions/{made[0].json()['id']}"
    assert made[0].json()["state"] == "paused" and made[0].json()["iteration"] == 0
    assert len(sessions(served)) == 2
    # the same model and scan, kept once
    assert len(client.get("/api/v1/models").json()) == len(client.get("/api/v1/scans").json()) == 1
    refused = client.post("/api/v1/sessions/sample", json={"scene": "kitchen"})
    assert refused.status_code == 422 and "'open'" in refused.json()["detail"]
