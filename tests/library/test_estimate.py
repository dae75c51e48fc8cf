"""Do an estimate's attributes say what result.json says, and is what is none refused with a sentence?"""

from __future__ import annotations

import copy
import json
import math
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import pmpnbp

EYE = np.eye(6).ravel().tolist()
ADVICE = "Next: check model, camera pose and prior, or give a (tighter) box around the object"
POSE = {"position": {"x": 1.0, "y": 2.0, "z": 3.0}, "orientation": {"x": 0.0, "y": 0.0, "z": 0.6, "w": 0.8}}
LINK = {
    "pose": POSE,
    "covariance": EYE,
    "std_xyz": [1.0, 1.0, 1.0],
    "expected_add": 0.01,
    "certain": False,
    "doubts": ["std_xyz", "elsewhere"],
    "visible_fraction": 0.5,
    "log_likelihood": -3.0,
    "modes": [{"weight": 0.75, "pose": POSE, "covariance": EYE}],
    "particle_std_xyz": [0.1, 0.2, 0.3],
    "particle_modes": [],
}
SLIDE = {"type": "prismatic", "position": 0.1, "std": 0.01, "interval": [0.09, 0.12], "lower": 0, "upper": 0.3}
HINGE = {"type": "revolute", "position": math.pi / 6, "std": None, "interval": None, "lower": -1, "upper": 1}
PLANAR = {
    "type": "planar",
    "position": [0.1, 0.2, math.pi / 2],
    "std": [0.1, 0.1, 0.1],
    "interval": [[0.0, 0.2], [0.1, 0.3], [1.5, 1.6]],
    "lower": [0, 0, -3],
    "upper": [1, 1, 3],
}
ENDS = {"parent": "base", "child": "tray"}
RESULT: dict[str, Any] = {
    "schema": "pmpnbp/estimate-2",
    "model": "cart",
    "method": "pmpnbp",
    "seed": 3,
    "iteration": 7,
    "converged": True,
    "frame_id": "world",
    "stamp": None,
    "certain": False,
    "max_std": 0.0025,
    "seconds": 1.5,
    "fit": "good",
    "fit_reason": "the scan confirms 96 % of what should be seen",
    "explained": 0.96,
    "effective_draws": 100.0,
    "posterior_iteration": 7,
    "links": {"base": LINK, "tray": LINK},
    "joints": {"slide": SLIDE | ENDS, "hinge": HINGE | ENDS, "floor": PLANAR | ENDS},
    "alternatives": [
        {"weight": 1.0, "links": {"base": {"pose": POSE}}, "joints": {"slide": 0.1, "floor": [0.1, 0.2, 0.3]}}
    ],
    "unknown": ["nothing tells the turn of 'base'"],
    "depth_noise": [0.001, 0.002],
    "depth_noise_area": [1.0, 7.5],
    "depth_distortion": [0.0, 0.0015],
    "nuisances": {"depth scale": {"value": 0.01, "std": 0.001, "prior_std": 0.02}},
}


def test_attributes_are_the_members() -> None:
    found = pmpnbp.Estimate.from_dict(RESULT)
    assert (found.model, found.iteration, found.explained, found.converged) == ("cart", 7, 0.96, True)
    base = found.links["base"]
    assert base.pose.tolist() == [1, 2, 3, 0.8, 0, 0, 0.6]
    assert base.covariance is not None and base.covariance.shape == (6, 6)
    # the x axis turns towards y by 2 atan(0.6 / 0.8)
    assert np.allclose(base.matrix, [[0.28, -0.96, 0, 1], [0.96, 0.28, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]])
    assert base.modes[0].weight == 0.75 and base.particle_modes == ()
    slide, hinge, floor = (found.joints[name] for name in ("slide", "hinge", "floor"))
    assert (slide.position, slide.std, slide.lowers.tolist()) == (0.1, 0.01, [0])
    assert slide.interval is not None and slide.interval.tolist() == [0.09, 0.12]
    assert (hinge.std, hinge.interval, hinge.stds, hinge.intervals) == (None, None, None, None)
    assert floor.positions.shape == (3,) and floor.intervals is not None and floor.intervals.shape == (3, 2)
    with pytest.raises(pmpnbp.PmpnbpError, match="joint 'floor' is planar and has 3 axes; ask for positions"):
        _ = floor.position
    assert found.alternatives[0].joints["floor"].tolist() == [0.1, 0.2, 0.3]
    assert found.nuisances["depth scale"].prior_std == 0.02
    assert found.depth_noise.tolist() == [0.001, 0.002]
    assert found.depth_noise_area.tolist() == [1.0, 7.5]
    assert found.depth_distortion.tolist() == [0.0, 0.0015]


def test_to_dict_is_what_came_and_a_copy() -> None:
    found = pmpnbp.Estimate.from_dict(RESULT)
    given_back = found.to_dict()
    assert given_back == RESULT
    given_back["links"].clear()
    assert found.to_dict() == RESULT


def test_it_reads_well() -> None:
    assert repr(pmpnbp.Estimate.from_dict(RESULT)) == (
        "<Estimate of cart after iteration 7. Found: the scan confirms 96 % of what should be seen; "
        "0 of 2 links are certain, not base, tray\n"
        "joint slide 10.00 (9.00 to 12.00) cm\n"
        "joint hinge 30.00°\n"
        "joint floor 10.00 (0.00 to 20.00) cm, 20.00 (10.00 to 30.00) cm, 90.00 (85.94 to 91.67)°>"
    )
    rigid = pmpnbp.Estimate.from_dict(RESULT | {"joints": {}})
    assert repr(rigid).splitlines()[1:] == [
        "link base at 1.000, 2.000, 3.000 m ± 1000.0 mm",
        "link tray at 1.000, 2.000, 3.000 m ± 1000.0 mm>",
    ]


@pytest.mark.parametrize(
    ("change", "advice"),
    [
        ({}, "Next: look again from where base, tray can be seen; 2.5 mm is asked for"),
        (
            {"links": {"base": LINK | {"certain": True}, "tray": LINK}},
            "Next: act on what is certain, or look again from where tray can be seen; 2.5 mm is asked for",
        ),
        ({"links": {"base": LINK | {"certain": True}}}, "Next: act; every link is known to 2.5 mm"),
        (
            {"links": {"base": LINK | {"doubts": ["alike", "expected_add", "elsewhere", "turned"]}}},
            "Next: no look would tell how these are turned: base",
        ),
        (
            {"links": {"base": LINK | {"doubts": ["alike"]}, "tray": LINK | {"certain": True}}},
            "Next: act on what is certain, to 2.5 mm; no look would tell how these are turned: base",
        ),
        (
            {"links": {"base": LINK | {"doubts": ["alike", "elsewhere"]}, "tray": LINK}},
            "Next: look again from where tray can be seen; 2.5 mm is asked for",
        ),
        ({"fit": "doubtful"}, ADVICE),
        ({"fit": "none"}, ADVICE),
        ({"fit": None}, "Next: let it make more iterations"),
    ],
)
def test_a_summary_is_three_lines(change: dict[str, Any], advice: str) -> None:
    found = pmpnbp.Estimate.from_dict(RESULT | change)
    verdict, joints, last = found.summary.splitlines()
    assert (verdict, last) == (found.verdict, advice)
    assert joints.startswith("joint slide 10.00 (9.00 to 12.00) cm; joint hinge 30.00°; joint floor ")
    many = {f"j{number}": SLIDE | ENDS for number in range(29)}
    long = pmpnbp.Estimate.from_dict(RESULT | change | {"joints": many})
    assert long.summary.splitlines()[1].endswith("joint j5 10.00 (9.00 to 12.00) cm; and 23 more")


def test_names_cannot_put_markup_into_a_notebook() -> None:
    hostile = RESULT | {"model": "<script>", "joints": {"<b>": SLIDE | ENDS}, "fit_reason": "<i>"}
    shown = pmpnbp.Estimate.from_dict(hostile)._repr_html_()
    assert "<script>" not in shown and "<b>&lt;script&gt;</b>" in shown and "<i>" not in shown


def test_one_that_was_read_has_no_scan() -> None:
    found = pmpnbp.Estimate.from_dict(RESULT)
    for ask in (found.picture, found.show, found.to_arviz):
        with pytest.raises(pmpnbp.PmpnbpError, match="not at hand"):
            ask()
    assert "<img" not in found._repr_html_()


# Values that stand for damage, and where: any member at any depth is taken out or replaced by one of these.
RUBBISH = st.one_of(st.none(), st.booleans(), st.integers(), st.text(max_size=3), st.sampled_from([[], {}, [{}]]))


@given(data=st.data())
def test_rubbish_is_refused_with_a_sentence_or_read(data: st.DataObject) -> None:
    members = copy.deepcopy(RESULT)
    place: Any = members
    while True:
        keys = list(place) if isinstance(place, dict) else list(range(len(place)))
        key = data.draw(st.sampled_from(keys))
        inside = place[key]
        if not isinstance(inside, dict | list) or not inside or data.draw(st.booleans()):
            break
        place = inside
    if isinstance(place, dict) and data.draw(st.booleans()):
        del place[key]
    else:
        place[key] = data.draw(RUBBISH)
    try:
        found = pmpnbp.Estimate.from_dict(members)
    except pmpnbp.PmpnbpError as error:
        assert str(error).startswith("this is no estimate as result.json has it")
    else:
        assert found.to_dict() == members


@pytest.mark.parametrize("text", ["", "[", "[]", "3", "null", '{"links": 3}', "[" * 100_000])
def test_files_that_hold_none_are_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "r.json").write_text(text)
    with pytest.raises(pmpnbp.PmpnbpError):
        pmpnbp.Estimate.load(tmp_path / "r.json")


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(pmpnbp.PmpnbpError, match=r"result 'no\.json' cannot be read: No such file"):
        pmpnbp.Estimate.load(tmp_path / "no.json")
    (tmp_path / "r.json").write_text(json.dumps(RESULT))
    assert pmpnbp.Estimate.load(str(tmp_path / "r.json")).model == "cart"


def test_importing_takes_nothing_that_takes_long() -> None:
    """Kernels, SciPy and the web come with what needs them."""
    script = (
        "import sys, pmpnbp\n"
        "assert 'numpy' not in sys.modules\n"
        "assert set(pmpnbp.__all__) <= set(dir(pmpnbp))\n"
        "from pmpnbp import Client, Estimate, Model, load_model, load_scan\n"
        "heavy = {'numba', 'scipy', 'open3d', 'trimesh', 'fastapi', 'viser', 'app'} & set(sys.modules)\n"
        "assert not heavy, heavy\n"
        "for name in pmpnbp.__all__: getattr(pmpnbp, name)\n"
        "assert not {'fastapi', 'viser', 'app'} & set(sys.modules)\n"
        "assert pmpnbp.__version__\n"
        "try: pmpnbp.nothing\n"
        "except AttributeError as error: assert 'nothing' in str(error)\n"
        "else: raise SystemExit('no error')\n"
    )
    subprocess.run([sys.executable, "-c", script], check=True)
