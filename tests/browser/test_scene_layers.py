"""Does each layer of the 3D view put into the picture what its switch says, and nothing while nobody looks?"""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from playwright.sync_api import Page, expect

from app.viewer.emphasis import INK
from pmpnbp.pictures.palette import KIND_COLOURS, KIND_NAMES, rgb
from pmpnbp.potentials.pixel_kinds import PixelKind
from tests.app import small_sessions as small
from tests.browser.conftest import DESK, PATIENCE, pixels
from tests.browser.scene_pointer import BARE, change, differing, ground, look_from_eye, settled
from tests.browser.session_page import opened, tab, view, wait, weighty, written
from tests.browser.session_page import parts as parts_of
from tests.servers import Served

expect.set_options(timeout=PATIENCE)

BEHIND_THE_CAMERA = {"position": [1.17, 1.92, 2.04], "look_at": [0.59, 0.39, 0.56], "up": [0.0, 0.0, 1.0]}


@pytest.fixture(scope="module")
def session(served: Served) -> str:
    """The path of a session with known truth that has found the object in six iterations, the last ones with
    messages, which are spread widely enough to be seen."""
    truth = json.loads((small.CABINET / "open" / "truth.json").read_text())
    config = small.QUICK | {"search_islands": 40, "diffusion_position_end": 0.02}
    return small.after(served.client, 6, name="a cabinet", truth=truth, config=config)


def coloured(seen: NDArray[np.uint8], colour: tuple[int, int, int], within: float = 40) -> int:
    """How many pixels are about of a colour: of its hue, as points have it where light falls on them."""
    return int((np.abs(seen.astype(int) - colour).max(axis=-1) < within).sum())


def test_without_a_graphics_card_less_is_drawn_unless_somebody_wants_it(
    page: Page, served: Served, session: str
) -> None:
    page = opened(page, served, session)
    wait(page, lambda: view(page, served)["economy"] is True)  # browsers of tests have none
    switch = tab(page, "Layers").get_by_role("switch", name="fewer points and pictures", exact=True)
    expect(switch).to_be_checked()
    switch.uncheck()
    wait(page, lambda: view(page, served)["economy"] is False)
    opened(page, served, session, "?economy=0")
    wait(page, lambda: view(page, served)["economy"] is False)
    tab(page, "Layers")
    expect(switch).not_to_be_checked()
    page.wait_for_url("**tab=layers*")
    page.reload()  # what the address asks for holds when it has changed
    page.locator("body[data-ready]").wait_for()
    expect(switch).not_to_be_checked()
    wait(page, lambda: view(page, served)["economy"] is False)


# Notes how many points the largest cloud had that was drawn since somebody asked.
_MOST = """{
  const place = WebGL2RenderingContext.prototype, draw = place.drawArrays;
  window.most = 0;
  place.drawArrays = function (mode, first, count) {
    if (mode === this.POINTS) window.most = Math.max(window.most, count);
    draw.call(this, mode, first, count);
  };
}"""


@pytest.mark.scene
def test_without_a_graphics_card_all_points_are_drawn_once_nothing_moves(
    page: Page, served: Served, session: str
) -> None:
    def most() -> int:
        asked = "(() => { const { most } = scene.contentWindow; scene.contentWindow.most = 0; return most; })()"
        return int(page.evaluate(asked))

    page.add_init_script(_MOST)
    page = opened(page, served, session)
    wait(page, lambda: most() > 50_000)
    box = page.locator("#scene").bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + 300, box["y"] + 200)
    page.mouse.down()
    seen = []
    while len(seen) < 4:
        for step in range(8):
            page.mouse.move(box["x"] + 300 + 4 * step, box["y"] + 200)
        seen += [one for one in [most()] if one]
    page.mouse.up()
    assert max(seen[2:]) < 20_000  # what was under way before the hand moved may have been all
    wait(page, lambda: most() > 50_000)


@pytest.mark.scene
def test_each_layer_is_drawn_by_its_switch(page: Page, served: Served, session: str) -> None:
    """One at a time over an empty scene; switched off again, the scene is as empty as before."""
    page = opened(page, served, session)
    panel = tab(page, "Layers")
    empty = look_from_eye(page, served, show=BARE, part="drawer1")
    assert coloured(empty, ground(empty), 2) > 0.97 * empty.shape[0] * empty.shape[1]
    drawn = {}
    names = ("support planes", "axes of the best particles", "truth", "ellipsoids of the particles", "particles")
    for name in names:
        switch = panel.get_by_role("switch", name=name, exact=True)
        switch.check()
        wait(page, lambda: differing(empty, shot(page)) > 30)
        drawn[name] = settled(page)
        said = view(page, served)["drawn"]["particles"]
        weigh = {part: len(weighty(served, session, part)) for part in parts(served, session)}
        assert said == (weigh if name == "particles" else {}), name
        switch.uncheck()
        wait(page, lambda: differing(empty, shot(page)) == 0)
    # those of the selected part; the others are faded
    for name, colour in parts(served, session).items():
        assert (coloured(drawn["particles"], rgb(colour)) > 5) == (name == "drawer1"), name
    assert coloured(drawn["truth"], INK["light"]) > 100
    axes = drawn["axes of the best particles"].astype(int)
    for channel in range(3):  # x red, y green, z blue
        rest = np.delete(axes, channel, axis=-1).max(axis=-1)
        assert ((axes[..., channel] - rest) > 60).sum() > 5
    panel.get_by_label("Confidence").fill("99")
    panel.get_by_role("switch", name="ellipsoids of the particles", exact=True).check()
    wider = 1.5 * differing(
        empty, drawn["ellipsoids of the particles"]
    )  # by the square of 3.4 standard deviations over 2.0
    wait(page, lambda: differing(empty, shot(page)) > wider)
    panel.get_by_role("switch", name="ellipsoids of the particles", exact=True).uncheck()
    change(page, served, {"camera": BEHIND_THE_CAMERA})
    wait(page, lambda: differing(empty, shot(page)) == 0)
    panel.get_by_role("switch", name="camera", exact=True).check()
    wait(page, lambda: differing(empty, shot(page)) > 100)
    outline = settled(page)
    panel.get_by_role("switch", name="depth image in the camera").check()
    wait(page, lambda: differing(outline, shot(page)) > 1000)
    assert differing(empty, drawn["support planes"]) > 0.1 * empty.shape[0] * empty.shape[1]


@pytest.mark.scene
def test_messages_are_those_of_the_chosen_edge(page: Page, served: Served, session: str) -> None:
    page = opened(page, served, session)
    empty = look_from_eye(page, served, show=BARE)
    page.get_by_role("button", name="between frame and drawer3").click()
    wait(page, lambda: differing(empty, shot(page)) > 30)
    seen, painted = settled(page), parts(served, session)
    assert view(page, served)["edge"] == ["frame", "drawer3"]
    # in the colours of those that say it, and of no other
    said = {name: coloured(seen, rgb(painted[name])) for name in painted}
    assert min(said["frame"], said["drawer3"]) > 5 and max(said["drawer1"], said["drawer2"]) == 0, said


@pytest.mark.scene
def test_colours_of_scan_and_particles(page: Page, served: Served, session: str) -> None:
    page = opened(page, served, session)
    panel = tab(page, "Layers")
    by_depth = look_from_eye(page, served, show={**BARE, "scan": True})
    panel.get_by_role("button", name="explained", exact=True).click()
    wait(page, lambda: differing(by_depth, shot(page)) > 500)
    explained = settled(page)
    for kind in (PixelKind.EXPLAINED, PixelKind.IN_FRONT):
        assert coloured(explained, rgb(KIND_COLOURS[kind])) > 20 + coloured(by_depth, rgb(KIND_COLOURS[kind])), kind
    legend = panel.locator("#explained-legend li")
    shown = (kind for kind in KIND_COLOURS if kind not in (PixelKind.NO_DEPTH, PixelKind.GOES_ON))
    expect(legend).to_have_text([*(KIND_NAMES[kind] for kind in shown), "not covered"])
    assert legend.nth(0).locator(".swatch").evaluate("e => getComputedStyle(e).backgroundColor") == "rgb(0, 114, 178)"

    panel.get_by_role("switch", name="points of the scan").uncheck()
    panel.get_by_role("switch", name="particles", exact=True).check()
    wait(page, lambda: view(page, served)["drawn"]["particles"] != {})
    by_part = settled(page)
    panel.get_by_role("button", name="by weight").click()
    wait(page, lambda: differing(by_part, shot(page)) > 30)
    paler = settled(page)
    assert paler.mean() > by_part.mean()
    # of 40 particles of a part most weigh little, some much
    for colour in parts(served, session).values():
        assert coloured(paler, rgb(colour)) < coloured(by_part, rgb(colour))


@pytest.mark.scene
def test_what_the_posterior_draws_is_there_at_rest_only(page: Page, served: Served) -> None:
    scan = small.upload_scan(served.client, "from_above")  # two drawers are hidden: they may be far from the estimate
    session = small.after(served.client, 2, name="a cabinet", scan_id=scan)
    served.client.post(f"{session}/run", json={"until": "converged"}).raise_for_status()
    newest = small.at_rest(served.client, session)["iteration"]
    page = opened(page, served, session)
    panel = tab(page, "Layers")
    empty = look_from_eye(page, served, show=BARE)
    for name in ("covariance ellipsoids", "where else it may be"):
        switch = panel.get_by_role("switch", name=name, exact=True)
        switch.check()
        wait(page, lambda: differing(empty, shot(page)) > 10)
        page.get_by_role("slider", name="Iteration").fill("1")
        wait(page, lambda: view(page, served)["drawn"]["iteration"] == 1)
        wait(page, lambda: differing(empty, shot(page)) == 0)
        page.get_by_role("button", name="Live").click()
        wait(page, lambda: view(page, served)["drawn"]["iteration"] == newest)
        wait(page, lambda: differing(empty, shot(page)) > 10)
        switch.uncheck()
        wait(page, lambda: differing(empty, shot(page)) == 0)


@pytest.mark.scene
def test_another_session_is_a_grey_ghost_and_a_table(page: Page, served: Served, session: str) -> None:
    other = small.after(served.client, 3, name="the other", seed=5)
    page = opened(page, served, session)
    alone = look_from_eye(page, served, show={**BARE, "estimate": True})
    panel = tab(page, "Compare")
    panel.get_by_label("Compare with").select_option(label="the other (3)")
    wait(page, lambda: differing(alone, shot(page)) > 500)

    mine, its = (served.client.get(f"{path}/estimate").json() for path in (session, other))
    expect(panel.locator("#compare-links tr")).to_have_count(4)
    for name in parts_of(mine):
        here, there = mine["links"][name], its["links"][name]
        a, b = (np.array([link["pose"]["position"][axis] for axis in "xyz"]) for link in (here, there))
        q, r = (np.array([link["pose"]["orientation"][axis] for axis in "xyzw"]) for link in (here, there))
        wanted = [100 * float(np.linalg.norm(a - b)), float(np.degrees(2 * np.arccos(min(1.0, abs(float(q @ r))))))]
        assert here["std_xyz"] is there["std_xyz"] is None  # neither is at rest
        *shown, std, its_std = cells(page, "#compare-links", name)
        assert (std, its_std) == ("–", "–")
        assert [number(text) for text in shown] == pytest.approx(wanted, abs=0.051)
    expect(panel.locator("#compare-fit")).to_have_text("Fit: not at rest here, not at rest there")
    assert any(one["pose"] != its["links"][name]["pose"] for name, one in mine["links"].items())
    for name, joint in mine["joints"].items():
        positions = 100 * joint["position"], 100 * its["joints"][name]["position"]
        wanted = [*positions, abs(positions[0] - positions[1])]
        assert [number(text) for text in cells(page, "#compare-joints", name)] == pytest.approx(wanted, abs=0.051)

    panel.get_by_role("button", name="Stop comparing").click()
    wait(page, lambda: differing(alone, shot(page)) == 0)


def test_six_plots_where_the_truth_is_known(new_page: Callable[..., Page], served: Served, session: str) -> None:
    page = opened(new_page(viewport=DESK), served, session)
    row = served.client.get(f"{session}/trace").json()["iterations"][-1]
    largest, seconds = max(row["add"].values()), 1000 * row["seconds"]
    spread = max(map(max, row["particle_std_xyz"].values()))
    wanted = {
        "std": "–",  # not at rest
        "particle-std": f"largest {written(spread)}",
        "effective": "smallest",
        "likelihood": f"{row['final_log_likelihood']:.1f}",
        "add": f"largest {written(largest)}",
        "seconds": f"{seconds:.0f}",
    }
    expect(page.locator(".plot:visible")).to_have_count(len(wanted))
    for name, now in wanted.items():
        plot = page.locator(f"[data-plot={name}]")
        expect(plot.locator(".now")).to_contain_text(now.replace("-", "\u2212"))
        # no title is cut off beside its number
        assert plot.locator(".plot-title").evaluate("(title) => title.scrollWidth <= title.clientWidth"), name
        wait(page, lambda plot=plot: float(pixels(plot.locator("canvas")).std()) > 5)  # type: ignore[misc]


@pytest.mark.scene
def test_nothing_is_drawn_for_a_page_that_is_not_seen(
    page: Page, new_page: Callable[..., Page], served: Served
) -> None:
    session = small.after(served.client, 2, name="a cabinet")
    page = opened(page, served, session)
    wait(page, lambda: (view(page, served)["drawn"] or {}).get("iteration") == 2)
    # a headless browser's pages are always seen: the page is told what it would hear
    see(page, False)
    wait(page, lambda: view(page, served)["hidden"])
    serial = view(page, served)["drawn"]["serial"]
    small.step(served.client, session, 3)
    watching = opened(new_page(), served, session)
    wait(watching, lambda: (view(watching, served)["drawn"] or {}).get("iteration") == 5)
    small.step(served.client, session, 1)
    wait(watching, lambda: view(watching, served)["drawn"]["iteration"] == 6)
    assert view(page, served)["drawn"] == {**view(page, served)["drawn"], "iteration": 2, "serial": serial}
    see(page, True)
    wait(page, lambda: view(page, served)["drawn"]["iteration"] == 6)
    assert view(page, served)["drawn"]["serial"] == serial + 1  # what came between is left out
    expect(page.locator("#shown")).to_have_text("6 / 6")


def shot(page: Page) -> NDArray[np.uint8]:
    return pixels(page.locator("#scene"))


def see(page: Page, seen: bool) -> None:
    page.evaluate(
        """(hidden) => {
          Object.defineProperty(document, "hidden", { configurable: true, get: () => hidden });
          document.dispatchEvent(new Event("visibilitychange"));
        }""",
        not seen,
    )


def parts(served: Served, session: str) -> dict[str, str]:
    """Names and colours."""
    found: list[dict[str, Any]] = served.client.get(f"{session}/graph").json()["parts"]
    return {part["name"]: part["colour"] for part in found}


def cells(page: Page, table: str, name: str) -> list[str]:
    """The texts of a table's row."""
    row = page.locator(f"{table} tr", has=page.get_by_role("rowheader", name=name, exact=True))
    return row.locator("td").all_inner_texts()


def number(text: str) -> float:
    """A number without its unit."""
    return float("".join(sign for sign in text.replace("\u2212", "-") if sign in "-.0123456789"))
