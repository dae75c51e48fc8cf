"""Does a browser get where its view is told to look from, whatever it does by itself, and is a hand's move told?"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from app.viewer import camera as camera_module
from app.viewer.camera import ATTEMPTS, SAME, Browser, Camera, Placement
from app.viewer.view_state import Eye


def eye(x: float) -> Eye:
    return Eye(position=(x, 0.0, 1.0), look_at=(0.0, 0.0, 0.5), up=(0.0, 0.0, 1.0))


# Where viser's page looks from before it has heard of anything; where the view begins; where it is told to look from.
OWN, HOME, TOLD = eye(-5.0), eye(2.0), eye(3.0)
PAGE = Eye(position=(3.0, 3.0, 3.0), look_at=(0.0, 0.0, 0.0), up=(0.0, 0.0, 1.0))


class Watched:
    """A camera whose one browser does what a test has it do."""

    def __init__(self) -> None:
        self.moved: list[Eye] = []
        self.placed: list[Eye] = []
        self.camera = Camera(lambda: None, self.moved.append)
        nothing: Any = SimpleNamespace(initial_camera=SimpleNamespace(), on_client_connect=id, on_client_disconnect=id)
        self.camera.begin(nothing, HOME)
        self.camera.joined(1, self.placed.append)

    def report(self, *eyes: Eye) -> None:
        for one in eyes:
            self.camera.reported(1, one)
        self.camera.tend()


@pytest.fixture(autouse=True)
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is put again without a wait."""
    monkeypatch.setattr(camera_module, "RETRY_SECONDS", 0.0)


@pytest.fixture
def watched() -> Watched:
    return Watched()


def test_it_is_put_there_until_it_is_there(watched: Watched) -> None:
    watched.camera.look(TOLD)
    watched.report(OWN)
    watched.report(HOME)
    assert watched.placed == [TOLD] * 3
    watched.report(TOLD)
    watched.report()
    assert watched.placed == [TOLD] * 3
    assert watched.moved == []
    assert watched.camera.wait() is None


@pytest.mark.parametrize("back", [OWN, HOME])
def test_what_it_does_by_itself_is_undone(watched: Watched, back: Eye) -> None:
    watched.report(OWN)
    watched.report(HOME)
    watched.camera.look(TOLD)
    watched.report(TOLD)
    before = len(watched.placed)
    watched.report(back)
    assert watched.placed[before:] == [TOLD]
    assert watched.moved == []


def test_a_page_that_says_twice_that_it_is_there_was_moved_by_nobody(watched: Watched) -> None:
    watched.report(HOME, HOME)
    watched.report(PAGE)
    watched.report(HOME)
    assert watched.moved == []


def test_a_hand_is_followed_and_never_pulled_back(watched: Watched) -> None:
    watched.report(OWN)
    watched.report(HOME)
    before = len(watched.placed)
    watched.report(eye(2.1), eye(2.4))
    watched.report(eye(2.8))
    watched.report(HOME)
    watched.report(OWN)
    assert watched.moved == [eye(2.4), eye(2.8), HOME, OWN]
    assert len(watched.placed) == before
    watched.report(eye(-4.0), OWN)  # there and back again between two tellings
    assert watched.moved[-1] == OWN and len(watched.moved) == 4


def test_one_that_never_comes_there_is_left_alone(watched: Watched) -> None:
    for _ in range(2 * ATTEMPTS):
        watched.report(OWN)
    assert watched.placed == [HOME] * ATTEMPTS
    assert watched.camera.wait() is None
    watched.camera.look(TOLD)
    assert watched.placed[-1] == TOLD


def test_one_that_comes_later_looks_from_where_a_hand_has_gone(watched: Watched) -> None:
    watched.report(HOME)
    watched.report(TOLD)
    later: list[Eye] = []
    watched.camera.joined(2, later.append)
    watched.camera.tend()
    assert later == [TOLD]


def test_without_anything_to_look_at_nothing_happens() -> None:
    Camera(lambda: None, lambda eye: None).look(TOLD)


PLACING, PLACED, MOVED, ABANDONED = Placement


@pytest.mark.parametrize(
    ("before", "reported", "after", "by_hand"),
    [
        (PLACING, OWN, PLACING, False),
        (PLACING, TOLD, PLACED, False),
        (PLACED, TOLD, PLACED, False),  # it says the same again
        (PLACED, PAGE, PLACING, False),  # where the page begins, which it had not reported
        (PLACED, TOLD.model_copy(update={"look_at": PAGE.look_at}), PLACING, False),  # half of the way from there
        (MOVED, PAGE, MOVED, True),
        (PLACED, HOME, PLACING, False),  # where it has been without a hand
        (PLACED, eye(HOME.position[0] + 2 * SAME), MOVED, True),
        (MOVED, HOME, MOVED, True),
        (ABANDONED, HOME, ABANDONED, False),
        (ABANDONED, TOLD, PLACED, False),
    ],
)
def test_every_report_leads_from_one_state_to_another(
    before: Placement, reported: Eye, after: Placement, by_hand: bool
) -> None:
    browser = Browser(lambda eye: None, before, strays=[] if before is MOVED else [HOME])
    assert browser.report(reported, TOLD) is by_hand
    assert browser.placement is after


@pytest.mark.parametrize("before", Placement)
def test_another_place_to_look_from_begins_anew(before: Placement) -> None:
    browser = Browser(lambda eye: None, before, attempts=ATTEMPTS, due=5.0)
    browser.send(HOME)
    assert (browser.placement, browser.attempts, browser.due, browser.strays) == (PLACING, 0, 0.0, [HOME])


def test_one_that_strays_after_the_last_attempt_is_left_where_it_is() -> None:
    browser = Browser(lambda eye: None, PLACED, attempts=ATTEMPTS, strays=[HOME])
    assert not browser.report(HOME, TOLD)
    assert browser.placement is ABANDONED
