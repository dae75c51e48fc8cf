"""Do files that are chosen or dropped on the start page become sessions, and is it said where they do not?"""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from playwright.sync_api import APIResponse, Page, Route, expect

from tests.app import small_sessions as small
from tests.browser.conftest import PATIENCE, Troubles
from tests.browser.start_page import arrived, card, emptied, sessions
from tests.servers import Served

SCENE = small.CABINET / "open"
ROBOT = small.CABINET.parent / "robot"
URDF, DEPTH, CAMERA = small.CABINET / "cabinet.urdf", SCENE / "depth.png", SCENE / "camera.json"
__all__ = ["emptied"]  # a fixture of every test here
expect.set_options(timeout=PATIENCE)


def test_a_server_that_gets_ready_says_so(page: Page, served: Served) -> None:
    ready = False
    page.route("**/healthz", lambda route: route.fulfill(json={"status": "ok", "version": "", "ready": ready}))
    page.goto(served.url)
    expect(page.get_by_text("The server is getting ready")).to_be_visible()
    ready = True
    expect(page.get_by_text("The server is getting ready")).to_be_hidden()
    expect(page.get_by_text("No session yet")).to_be_visible()


def test_files_are_chosen_and_become_a_session(page: Page, served: Served) -> None:
    page.goto(served.url)
    expect(page.get_by_text("No session yet")).to_be_visible()
    page.get_by_text("Advanced:").click()  # there is more to ask for: the page does not go on by itself
    page.get_by_label("Choose files").set_input_files([DEPTH, CAMERA, URDF])
    uploads = page.get_by_role("list", name="Uploads")
    expect(uploads.get_by_text("7 links, 6 joints, 4 parts")).to_be_visible()
    expect(uploads.get_by_text("300 873 points, 640 × 480")).to_be_visible()
    (model,) = served.client.get("/api/v1/models").json()
    (scan,) = served.client.get("/api/v1/scans").json()
    assert scan["camera"]["T_world_camera"] == pytest.approx(json.loads(CAMERA.read_text())["T_world_camera"])
    expect(page.get_by_label("Model", exact=True)).to_have_value(model["id"])
    expect(page.get_by_role("checkbox", name="depth.png")).to_be_checked()

    page.get_by_role("textbox", name="Name", exact=True).fill("made by hand")
    page.get_by_label("any orientation").check()
    page.get_by_role("button", name="Bounds of the scans").click()
    expect(page.get_by_label("x from, centimetres")).to_have_value(f"{100 * round(scan['bounds'][0], 3):.6g}")
    for label, number in zip(("x from", "y from", "z from", "x to", "y to", "z to"), small.ROI, strict=True):
        page.get_by_label(f"{label}, centimetres").fill(f"{100 * number:.6g}")
    page.get_by_label("Method").select_option("particle filter")
    page.get_by_label("Preset").select_option("paper")
    page.get_by_label("Particles per part").fill("30")
    page.get_by_label("Iterations", exact=True).fill("12")
    page.get_by_label("Seed").fill("5")
    expect(page.get_by_role("group", name="Inference")).to_contain_text(
        "particle filter, paper, 30 particles, 12 iterations"
    )
    page.get_by_role("button", name="Next: where is it?").click()
    id = arrived(page)
    found = served.client.get(f"/api/v1/sessions/{id}").json()
    assert (found["name"], found["model_id"], found["scan_ids"]) == ("made by hand", model["id"], [scan["id"]])
    assert (found["particles"], found["iterations"], found["seed"]) == (30, 12, 5)
    assert found["method"] == "particle_filter" and found["config"] == {"preset": "paper"}
    assert found["roi"] == small.ROI and found["prior"] == {"kind": "uniform", "orientation": "any"}
    page.goto(served.url)
    expect(card(page, "made by hand").locator(".method")).to_have_text("particle filter")
    # a mesh that is chosen by itself goes where the model names it: robot.urdf says meshes/head.obj
    page.get_by_label("Choose files").set_input_files([ROBOT / "robot.urdf", ROBOT / "meshes" / "head.obj"])
    expect(page.get_by_role("list", name="Uploads").get_by_text("12 links, 11 joints, 12 parts")).to_be_visible()


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
    expect(page.get_by_label("z to, centimetres")).to_have_value(f"{100 * small.ROI[5]:.6g}")
    # a scan is missing, and the page says so before the server has to
    page.get_by_role("button", name="Next: where is it?").click()
    expect(page.locator("#create-trouble")).to_have_text(re.compile("A scan is missing"))
    scan_id = small.upload_scan(served.client)
    page.reload()
    page.locator(f"input[value='{scan_id}']").check()
    page.get_by_text("Advanced:").click()
    page.get_by_label("about where I say").check()
    page.get_by_label("or from a file").set_input_files(SCENE / "prior.json")
    expect(page.get_by_label("prior.json", exact=True)).to_have_value((SCENE / "prior.json").read_text())
    page.get_by_role("button", name="Next: where is it?").click()
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
    large = {"name": "large.npy", "mimeType": "application/octet-stream", "buffer": bytes(2 << 20)}
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

    # and with its file, chosen after it, of itself
    uploads.get_by_role("button", name=f"Dismiss {DEPTH.name}").click()
    page.get_by_label("camera.json", exact=True).fill("")
    page.get_by_label("Choose files").set_input_files([DEPTH])
    expect(uploads.get_by_role("alert").filter(visible=True)).to_have_text(said)
    page.get_by_label("Choose files").set_input_files([CAMERA])
    expect(uploads.get_by_text("300 873 points")).to_be_visible()

    page.get_by_label("Choose files").set_input_files({"name": "notes.md", "mimeType": "text/plain", "buffer": b"#"})
    expect(uploads.get_by_role("alert").filter(visible=True)).to_contain_text("'notes.md' is none of the files")

    # and what makes no session: a box with nothing in it
    small.upload_model(served.client)
    page.reload()
    page.get_by_role("checkbox", name="depth.png").first.check()
    page.get_by_text("Advanced:").click()
    for label in ("x from", "y from", "z from", "x to", "y to", "z to"):
        page.get_by_label(f"{label}, centimetres").fill("7000")
    asked = {
        "model_id": served.client.get("/api/v1/models").json()[0]["id"],
        "scan_ids": [served.client.get("/api/v1/scans").json()[0]["id"]],
        "roi": [70] * 6,
    }
    said = served.client.post("/api/v1/sessions", json=asked).json()["detail"]
    page.get_by_role("button", name="Next: where is it?").click()
    expect(page.locator("#create-trouble")).to_have_text(said)
    page.get_by_label("z to, centimetres").fill("")
    page.get_by_role("button", name="Next: where is it?").click()
    expect(page.locator("#create-trouble")).to_contain_text("5 of its 6 numbers")
    assert sessions(served) == []


def test_answers_that_come_late_take_nothing_back_and_lack_nowhere(page: Page, served: Served) -> None:
    """As where the server is busy: of the models before one was sent, and of the settings' defaults."""
    late: list[tuple[Route, APIResponse]] = []

    def hold(route: Route) -> None:
        if route.request.method == "GET" and not late:
            late.append((route, route.fetch()))
        else:
            route.continue_()

    page.route("**/api/v1/models", hold)
    defaults: list[Route] = []
    page.route("**/api/v1/settings", lambda route: defaults.append(route))
    page.goto(served.url)
    page.get_by_label("Choose files").set_input_files([URDF])
    model = page.get_by_label("Model", exact=True)
    expect(model).to_have_value(re.compile("[0-9a-f]{16}"))
    route, none = late[0]
    assert none.json() == []
    with page.expect_response("**/api/v1/models"):
        route.fulfill(response=none)
    page.evaluate("() => new Promise((done) => setTimeout(done, 50))")
    expect(model).to_have_value(re.compile("[0-9a-f]{16}"))
    page.get_by_label("Choose files").set_input_files([DEPTH, CAMERA, URDF])
    expect(page.get_by_role("list", name="Uploads").get_by_text("300 873 points")).to_be_visible()
    page.evaluate("() => new Promise((done) => setTimeout(done, 50))")
    defaults[0].continue_()
    found = served.client.get(f"/api/v1/sessions/{arrived(page)}").json()
    assert (found["particles"], found["iterations"], found["seed"]) == (400, 100, 0)


def test_a_sample_is_one_click_away(page: Page, served: Served) -> None:
    page.goto(served.url)
    page.get_by_role("button", name="Open a sample session").click()
    id = arrived(page)
    first = served.client.get(f"/api/v1/sessions/{id}").json()
    assert first["name"] == "Sample: a cabinet with an open drawer" and first["roi"] == small.ROI
    expect(page.locator("#progress-number")).not_to_have_text("0")  # its page has set it going
    served.client.post(f"/api/v1/sessions/{id}/pause")
    page.goto(served.url)
    page.get_by_label("Sample scene").select_option(label="A cupboard with its door ajar")
    expect(page.get_by_text("One hinge, a revolute joint.")).to_be_visible()
    page.get_by_role("button", name="Open", exact=True).click()
    page.wait_for_url(re.compile("/sessions/(?!" + id + ")[0-9a-f]{16}/"))
    assert [session["name"] for session in sessions(served)][1:] == ["Sample: a cupboard with its door ajar"]


def test_a_click_before_the_list_of_samples_has_come_opens_one(page: Page, served: Served) -> None:
    held: list[Route] = []
    page.route("**/api/v1/samples", lambda route: held.append(route))
    page.goto(served.url)
    button = page.get_by_role("button", name="Open a sample session")
    button.click()
    expect(button).to_be_disabled()
    held[0].continue_()
    arrived(page)


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
    listed.get_by_role("button", name="Name of the recording yesterday.sqlite").click()
    expect(listed.get_by_label("Tags")).to_be_hidden()
    expect(listed.get_by_label("Name", exact=True)).to_be_focused()
    page.keyboard.type("the arm, yesterday")
    page.keyboard.press("Enter")
    expect(listed.get_by_role("link", name="the arm, yesterday")).to_have_attribute("href", f"/sessions/{id}/")
    expect(listed.get_by_role("button", name="Name of the recording the arm, yesterday")).to_be_focused()
    assert served.client.get(f"/api/v1/sessions/{id}").json()["name"] == "the arm, yesterday"
    listed.get_by_role("button", name="Delete the recording the arm, yesterday").click()
    page.get_by_role("dialog").get_by_role("button", name="Delete").click()
    expect(page.get_by_role("region", name="Recordings")).to_have_count(0)
    assert served.client.get("/api/v1/recordings").json() == []
