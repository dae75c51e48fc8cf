"""Is what sessions look at read again only where it is another file, or looked at in another way?"""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from app.sessions.document import prepare
from app.sessions.kept_inputs import MODEL_BYTES, model_in, observation_of
from pmpnbp.errors import ModelError
from pmpnbp.scene.observe import observe
from pmpnbp.scene.scan_files import load_scan
from tests.app.small_sessions import CABINET, ROI, body, upload_model, upload_scan
from tests.servers import Served


@pytest.fixture
def model_file(tmp_path: Path) -> Path:
    return Path(shutil.copy(CABINET / "cabinet.urdf", tmp_path))


def test_a_model_is_read_again_where_its_file_is_another_or_the_budget_is(model_file: Path, tmp_path: Path) -> None:
    first = model_in(model_file, 60)
    assert model_in(model_file, 60) is first
    coarse, fine = (model.parts[0].inference_mesh.faces for model in (model_in(model_file, 16), first))
    assert len(coarse) <= 16 < len(fine)
    twin = Path(shutil.copy(model_file, tmp_path / "twin.urdf"))
    assert model_in(twin, 60) is not first
    model_file.write_text("<robot/>")
    with pytest.raises(ModelError):
        model_in(model_file, 60)
    model_file.unlink()
    with pytest.raises(ModelError):
        model_in(model_file, 60)


def test_a_model_that_takes_much_is_read_each_time(model_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(model_in.cache, "getsizeof", lambda model: MODEL_BYTES + 1)
    assert model_in(model_file, 60) is not model_in(model_file, 60)


def test_a_scene_is_observed_again_where_anything_of_it_is_another(tmp_path: Path) -> None:
    files = [Path(shutil.copy(CABINET / "open" / "depth.png", tmp_path / f"{name}.png")) for name in ("one", "two")]
    scan = load_scan(CABINET / "open" / "depth.png", CABINET / "open" / "camera.json")
    first = observation_of(files[:1], [scan], ROI, 80, 1.0)
    assert observation_of(files[:1], [scan], tuple(ROI), 80, 1.0) is first
    expected = observe([scan], np.array(ROI), width=80, length=1.0)
    assert np.array_equal(first.points, expected.points) and np.array_equal(first.planes, expected.planes)
    wider = [*ROI[:3], *(1.1 * corner for corner in ROI[3:])]
    others = [
        observation_of(files[1:], [scan], ROI, 80, 1.0),
        observation_of(files, [scan, scan], ROI, 80, 1.0),
        observation_of(files[:1], [scan], None, 80, 1.0),
        observation_of(files[:1], [scan], wider, 80, 1.0),
        observation_of(files[:1], [scan], ROI, 100, 1.0),
        observation_of(files[:1], [scan], ROI, 80, 0.1),
    ]
    os.utime(files[0], ns=(0, 0))
    others.append(observation_of(files[:1], [scan], ROI, 80, 1.0))
    assert all(other is not first for other in others)
    assert [len(other.views) for other in others] == [1, 2, 1, 1, 1, 1, 1]


def test_a_session_looks_at_what_its_recording_will(shared: Served) -> None:
    """The same pixels, finer than without a model: the cabinet is much shorter than the whole picture."""
    asked = body(upload_model(shared.client), upload_scan(shared.client), roi=None, method="pmpnbp")
    problem, inputs = prepare(shared.app.state.store, asked)
    (seen,), (again,) = problem.observation.views, inputs.problem().observation.views
    np.testing.assert_array_equal(seen.depth, again.depth)
    (coarse,) = observe(inputs.scans, None, width=80).views
    assert seen.binned < coarse.binned
    assert seen.camera.fx * seen.binned == pytest.approx(coarse.camera.fx * coarse.binned)
