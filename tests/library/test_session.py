"""Is what a program gets in Python what the command line and a server give, and can it be stepped through and changed?

Small sessions of the sample cabinet, as tests/app/small_sessions.py makes them.
"""

from __future__ import annotations

import json
import urllib.request
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pmpnbp
from app import cli
from pmpnbp.library import page
from tests.app.small_sessions import CABINET, QUICK, ROI

MODEL, SCENE = CABINET / "cabinet.urdf", CABINET / "open"
SCAN: dict[str, Any] = {"camera": SCENE / "camera.json", "roi": ROI}
SMALL: dict[str, Any] = {"particles": 40, "seed": 11, **QUICK}


def members(found: pmpnbp.Estimate) -> dict[str, Any]:
    """Those of result.json that are the same each time."""
    return {name: value for name, value in found.to_dict().items() if name != "seconds"}


def session(**more: Any) -> pmpnbp.Session:
    return pmpnbp.Session(MODEL, SCENE / "depth.png", **SCAN, **SMALL, **more)


@pytest.fixture(scope="module")
def estimated(tmp_path_factory: pytest.TempPathFactory) -> tuple[pmpnbp.Estimate, Path]:
    """An estimate, and the recording of how it was made."""
    path = tmp_path_factory.mktemp("library") / "recording.sqlite"
    model, scan = pmpnbp.load_model(MODEL, triangles=60), pmpnbp.load_scan(SCENE / "depth.png", SCENE / "camera.json")
    return pmpnbp.estimate(model, scan, roi=np.array(ROI), recording=path, **SMALL), path


def test_it_is_what_the_command_line_gives(estimated: tuple[pmpnbp.Estimate, Path], tmp_path: Path) -> None:
    config = [word for name, value in QUICK.items() for word in ("--config", f"{name}={value}")]
    words = ["estimate", str(MODEL), str(SCENE / "depth.png"), "--camera", str(SCENE / "camera.json"), "--quiet"]
    words += [
        f"--roi={','.join(map(str, ROI))}",
        "--particles",
        "40",
        "--seed",
        "11",
        "--out",
        str(tmp_path / "r.json"),
    ]
    assert cli.main([*words, *config]) == 0
    assert members(pmpnbp.Estimate.load(tmp_path / "r.json")) == members(estimated[0])


def test_stepping_gives_the_same_as_an_estimate_and_as_its_recording(estimated: tuple[pmpnbp.Estimate, Path]) -> None:
    found, path = estimated
    with session() as stepped, pmpnbp.open_recording(path) as recorded:
        made = [stepped.newest, *stepped]
        assert [one.number for one in made] == list(range(found.iteration + 1)) == [one.number for one in recorded]
        assert [one.converged for one in made] == [False] * found.iteration + [True]
        assert members(stepped.estimate()) == members(found) == members(recorded.estimate())
        for ours, theirs in zip(made, recorded, strict=True):
            assert ours.stage == theirs.stage and ours.effective_sample_size == theirs.effective_sample_size
            for link in found.links:
                assert np.array_equal(ours.particles(link), theirs.particles(link))
                assert np.array_equal(ours.log_weights(link), theirs.log_weights(link))
                assert np.array_equal(ours.poses[link], theirs.poses[link])
        # a posterior before rest, asked of either: of what the recording has, too
        assert members(made[4].estimate()) == members(recorded.estimate(4))
        assert made[4].estimate().fit is not None and made[1].estimate().fit is None


def test_what_is_asked_on_the_way_changes_nothing() -> None:
    """As long as the estimate stays at rest its posterior is that of where it came to rest, whoever asked before."""
    told = []
    for ask in (False, True):
        made = session(iterations=30)
        for iteration in made:
            if ask:
                iteration.estimate()
        for _ in range(3):
            made.step()
            if ask:
                made.estimate()
        told.append(members(made.estimate()))
    straight = session(iterations=30)
    straight.step(int(told[0]["iteration"]))
    assert told[0] == told[1] == members(straight.estimate())
    assert told[0]["posterior_iteration"] < told[0]["iteration"] - 2


def test_a_scan_has_one_camera() -> None:
    scan, camera = pmpnbp.load_scan(SCENE / "depth.png", SCENE / "camera.json"), SCENE / "camera.json"
    with pytest.raises(pmpnbp.PmpnbpError, match="loaded with its own"):
        pmpnbp.Session(MODEL, scan, camera=camera, roi=ROI, **SMALL)
    with pytest.raises(pmpnbp.PmpnbpError, match="loaded with its own"):
        session().add_scan(scan, camera)


@pytest.mark.parametrize(("kind", "name"), [("links", "drawer9"), ("joints", "slid1")])
def test_a_truth_of_what_the_model_does_not_have_is_refused(kind: str, name: str, tmp_path: Path) -> None:
    truth = json.loads((SCENE / "truth.json").read_text())
    truth[kind][name] = next(iter(truth[kind].values()))
    (tmp_path / "truth.json").write_text(json.dumps(truth))
    with pytest.raises(pmpnbp.PmpnbpError, match=f"{kind[:-1]} '{name}' of the truth is not in the model"):
        session(truth=tmp_path / "truth.json")


def test_an_iteration_tells_its_belief(estimated: tuple[pmpnbp.Estimate, Path]) -> None:
    with pmpnbp.open_recording(estimated[1]) as recorded:
        last = recorded[-1]
        assert last.particles("drawer1").shape == (40, 7)
        assert np.isclose(np.exp(last.log_weights("drawer1")).sum(), 1)
        particles, log_weights = last.message("frame", "handle1")
        assert particles.shape == (40, 7) and log_weights.shape == (40,)
        # a handle is fixed to its drawer: its particles are the drawer's, carried along
        apart = np.linalg.norm(last.particles("drawer1")[:, :3] - last.particles("handle1")[:, :3], axis=1)
        assert np.ptp(apart) < 1e-9
        with pytest.raises(pmpnbp.PmpnbpError, match="link 'door' is not in the model; it has frame, "):
            last.particles("door")
        with pytest.raises(pmpnbp.PmpnbpError, match="no message from 'drawer1' to 'drawer2'"):
            last.message("drawer1", "drawer2")
        with pytest.raises(pmpnbp.PmpnbpError, match=r"iteration 1 \(search\) has no message"):
            recorded[1].message("frame", "drawer1")
        with pytest.raises(IndexError, match=f"it has 0 to {len(recorded) - 1}"):
            recorded[len(recorded)]
        with pytest.raises(pmpnbp.PmpnbpError, match=f"it has 0 to {len(recorded) - 1}"):
            recorded.estimate(len(recorded))


def test_changes_hold_from_the_next_iteration_on_and_are_recorded(tmp_path: Path) -> None:
    path = tmp_path / "recording.sqlite"
    with session(recording=path) as changed:
        for _ in changed:
            pass
        assert changed.converged
        before = changed.newest.number
        changed.change(tolerance_end=0.02)
        assert not changed.converged
        changed.add_scan(CABINET / "second_view" / "depth.png", CABINET / "second_view" / "camera.json")
        assert changed.step(2).number == before + 2
        found = changed.estimate()
        assert found.depth_noise.shape == found.depth_noise_area.shape == found.depth_distortion.shape == (2,)
        again = changed._recorded(changed.newest.number, tmp_path / "unused.sqlite")
        assert again == path
    with pmpnbp.open_recording(path) as recorded:
        assert members(recorded.estimate()) == members(found)
        assert recorded.estimate(before).depth_noise.shape == (1,)
    with pytest.raises(pmpnbp.PmpnbpError, match="closed"):
        changed.step()
    with pytest.raises(pmpnbp.PmpnbpError, match="closed"):
        changed.change(tolerance_end=0.02)


def test_without_a_recording_one_is_made_again_for_the_page(tmp_path: Path) -> None:
    with session(max_std=0.02) as changed:
        changed.step(3)
        changed.change(tolerance_end=0.02)
        changed.step(2)
        changed.add_scan(CABINET / "second_view" / "depth.png", CABINET / "second_view" / "camera.json", "replaces")
        changed.step(3)
        found = changed.estimate()
        path = changed._recorded(8, tmp_path / "again.sqlite")
    with pmpnbp.open_recording(path) as recorded:
        assert len(recorded) == 9
        assert members(recorded.estimate()) == members(found) and found.max_std == 0.02
    with pmpnbp.open_recording(path, max_std=0.001) as recorded:
        assert recorded.estimate().max_std == 0.001


def test_the_page_shows_it(
    estimated: tuple[pmpnbp.Estimate, Path], monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(page, "_servers", [])
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER"):
        monkeypatch.delenv(name, raising=False)
    estimated[0].show()
    try:
        link = capfd.readouterr().out.strip()
        _, _, id = link.rstrip("/").rpartition("/")
        with urllib.request.urlopen(link.replace(f"sessions/{id}/", f"api/v1/sessions/{id}/estimate")) as answer:
            shown = json.load(answer)
        assert shown["iteration"] == estimated[0].iteration and shown["links"] == estimated[0].to_dict()["links"]
    finally:
        (server,) = page._servers
        page._end()
    assert server.returncode is not None


def test_the_picture_and_the_draws_are_at_hand(estimated: tuple[pmpnbp.Estimate, Path]) -> None:
    found = estimated[0]
    assert found.picture(160).startswith(b"\x89PNG")
    assert 'src="data:image/png;base64,' in found._repr_html_()
    draws = found.to_arviz(200)
    assert draws.posterior["joint_position"].shape == (1, 200, 3)
    middle = draws.posterior["joint_position"].sel(joint="slide1").mean().item()
    # of 200 draws the mean is within five of its standard errors but for six times in ten million
    joint = found.joints["slide1"]
    assert joint.std is not None and abs(middle - joint.position) < 5 * joint.std / np.sqrt(200) + joint.std


@pytest.mark.parametrize(
    ("more", "sentence"),
    [
        ({"roi": [0, 1]}, r"roi is \[0, 1\]; expected x0 y0 z0 x1 y1 z1, metres"),
        ({"roi": "0,1,2,3,4,nan"}, "expected x0 y0 z0 x1 y1 z1, metres"),
        ({"roi": 3}, "expected x0 y0 z0 x1 y1 z1, metres"),
        ({"particles": 1}, "'particles' is 1; it must be a finite number of at least 2"),
        ({"particles": "many"}, "'particles' is 'many'; it must be a whole number"),
        ({"particles": 10**9}, "'particles' is 1000000000; it must be at most 20000"),
        ({"iterations": -1}, "'iterations' is -1"),
        ({"seed": 0.5}, "'seed' is 0.5; it must be a whole number"),
        ({"max_std": float("nan")}, "'max_std' is nan"),
        ({"method": "magic"}, "'method' is 'magic'; it can be pmpnbp or particle_filter"),
        ({"tolerance": 1}, "setting 'tolerance' does not exist; there are preset, image_width"),
        ({"camera": None}, "scan 'depth.png' is a depth image and needs a camera file; none was given"),
        ({"camera": {"width": 3}}, "the camera has no 'height'"),
        ({"camera": [SCENE / "camera.json"] * 2}, "2 cameras were given for 1 scans; expected one for all or for each"),
        ({"prior": {"kind": "none"}}, "'kind' of the prior is 'none'"),
        ({"camera": b"{}"}, r"the camera is b'{}'; expected the path of a camera\.json, or its members as a dict"),
        ({"camera": ' {"width": 3}'}, r"the camera is JSON text; expected the path of a camera\.json, or its members"),
        ({"prior": 5}, r"the prior is 5; expected the path of a prior\.json, or its members as a dict"),
        ({"prior": '{"kind": "uniform"}'}, r"the prior is JSON text; expected the path of a prior\.json"),
        ({"max_std": 0}, "'max_std' is 0; expected metres above zero"),
        ({"max_std": -1}, "'max_std' is -1; expected metres above zero"),
        ({"prior": "no.json"}, "prior file 'no.json' cannot be read"),
        ({"truth": "no.json"}, "truth file 'no.json' cannot be read"),
    ],
)
def test_what_is_of_no_use_is_said_in_a_sentence(more: dict[str, Any], sentence: str) -> None:
    with pytest.raises(pmpnbp.PmpnbpError, match=sentence):
        pmpnbp.Session(MODEL, SCENE / "depth.png", **(SCAN | SMALL | more))


def test_no_scan_at_all_is_said() -> None:
    with pytest.raises(pmpnbp.PmpnbpError, match="no scan was given"):
        pmpnbp.Session(MODEL, [], **SCAN)
    with pytest.raises(pmpnbp.PmpnbpError, match="a scan is 5; expected the path of a file, an array, or what"):
        pmpnbp.Session(MODEL, 5, **SCAN)  # type: ignore[arg-type]
    with pytest.raises(pmpnbp.PmpnbpError, match="the model is 5; expected the path of a URDF or zip"):
        pmpnbp.Session(5, SCENE / "depth.png", **SCAN)  # type: ignore[arg-type]


def test_scans_that_do_not_go_together_are_refused_and_change_nothing() -> None:
    camera = json.loads((SCENE / "camera.json").read_text())
    scan = pmpnbp.load_scan(SCENE / "depth.png", camera)
    elsewhere = pmpnbp.load_scan(SCENE / "depth.png", {**camera, "frame_id": "map"})
    twice = "scan 2 of 2 is scan 1 again"
    for other, mode, sentence in (
        (scan, "joins", twice),
        (elsewhere, "joins", "in different world frames, map, world"),
        (elsewhere, "replaces", "in different world frames, map, world"),
    ):
        if mode == "joins":
            with pytest.raises(pmpnbp.PmpnbpError, match=sentence):
                pmpnbp.Session(MODEL, [scan, other], roi=ROI, **SMALL)
        with session() as kept:
            with pytest.raises(pmpnbp.PmpnbpError, match=sentence):
                kept.add_scan(other, mode=mode)  # type: ignore[arg-type]
            assert kept._inputs.scans == kept._first.scans and not kept._changes
    files = [str(SCENE / "depth.png")] * 2
    words = ["estimate", str(MODEL), *files, "--camera", str(SCENE / "camera.json"), "--quiet"]
    assert cli.main(words) == 2
    with session() as moved:
        moved.add_scan(scan, mode="replaces")  # a scene that has moved on may look the same
        assert moved.step().number == 1


@pytest.mark.parametrize("iterations", [-1, 1.5, "2", None])
def test_steps_that_are_no_number_are_refused(iterations: Any) -> None:
    with session() as kept:
        with pytest.raises(pmpnbp.PmpnbpError, match=f"iterations to make are {iterations!r}; expected a whole number"):
            kept.step(iterations)
        assert kept.step(0).number == 0


def test_a_change_that_is_none_changes_nothing() -> None:
    with session() as kept:
        with pytest.raises(pmpnbp.PmpnbpError, match="does not exist"):
            kept.change(tolerance=1)
        with pytest.raises(pmpnbp.PmpnbpError, match="needs a camera"):
            kept.add_scan(SCENE / "depth.png")
        with pytest.raises(pmpnbp.PmpnbpError, match="mode is 'adds'; it can be joins or replaces"):
            kept.add_scan(SCENE / "depth.png", SCENE / "camera.json", "adds")  # type: ignore[arg-type]
        for _ in kept:
            pass
        found = members(kept.estimate())
    with session() as other:
        for _ in other:
            pass
        assert members(other.estimate()) == found


def test_a_recording_that_is_none_is_refused(tmp_path: Path) -> None:
    with pytest.raises(pmpnbp.PmpnbpError, match=r"recording 'no\.sqlite' is not there"):
        pmpnbp.open_recording(tmp_path / "no.sqlite")
    (tmp_path / "text.sqlite").write_text("text")
    with pytest.raises(pmpnbp.PmpnbpError, match=r"text\.sqlite"):
        pmpnbp.open_recording(tmp_path / "text.sqlite")
    with pytest.raises(pmpnbp.PmpnbpError, match=r"'text\.sqlite' is there and is no recording"):
        session(recording=tmp_path / "text.sqlite")
    assert (tmp_path / "text.sqlite").read_text() == "text"


def test_arrays_are_scans_as_files_are(tmp_path: Path) -> None:
    camera = json.loads((SCENE / "camera.json").read_text())
    of_file = pmpnbp.load_scan(SCENE / "depth.png", SCENE / "camera.json")
    of_array = pmpnbp.load_scan(of_file.depth, camera)
    assert np.array_equal(of_file.depth, of_array.depth)
    assert vars(of_file.camera).keys() == vars(of_array.camera).keys()
    assert all(np.array_equal(value, getattr(of_array.camera, name)) for name, value in vars(of_file.camera).items())
    rows, columns = np.indices(of_file.depth.shape)
    x = (columns - camera["cx"]) / camera["fx"] * of_file.depth
    y = (rows - camera["cy"]) / camera["fy"] * of_file.depth
    points = np.stack([x, y, of_file.depth], axis=-1)
    assert np.array_equal(pmpnbp.load_scan(points, camera).depth, of_file.depth)
    loose = points.reshape(-1, 3)[points.reshape(-1, 3)[:, 2] > 0]
    assert pmpnbp.load_scan(loose.astype(np.float32)).depth.max() > 0
    for array, sentence in (
        (np.zeros((4, 4, 4)), r"has the shape \(4, 4, 4\)"),
        (np.zeros(5), r"expected \(H, W\)"),
        (np.array([["a"]]), "expected real numbers"),
        (np.full((48, 64), 1200, dtype=np.uint16), "expected floats in metres"),
    ):
        with pytest.raises(pmpnbp.PmpnbpError, match=sentence):
            pmpnbp.load_scan(array, camera)


def test_a_model_tells_what_it_is() -> None:
    model = pmpnbp.load_model(str(MODEL))
    assert (model.name, len(model.links)) == ("cabinet", 7)
    assert model.joints == ("slide1", "slide2", "slide3")
    assert model.parts["drawer1"] == ("drawer1", "handle1")
    assert repr(model) == "<Model cabinet: 7 links in 4 parts, joints ['slide1', 'slide2', 'slide3']>"


def test_what_was_found_before_a_change_says_that_it_is_outdated() -> None:
    with session() as made:
        made.step(2)
        before = made.estimate(posterior=False)
        made.change(effective_share=0.2)
        after = made.estimate(posterior=False)
        assert (before.outdated, after.outdated) == (False, True)
        assert after.verdict == f"Outdated, scans or settings have changed since: {before.verdict}"
        made.step()
        assert not made.estimate(posterior=False).outdated
