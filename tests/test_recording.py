"""A recording holds every iteration bit for bit, and opens whatever happened to its writer."""

from __future__ import annotations

import json
import os
import shutil
import signal
import sqlite3
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pmpnbp.errors import ModelError, RecordingError
from pmpnbp.geometry import poses
from pmpnbp.inference import run
from pmpnbp.inference.belief import IterationReport, State
from pmpnbp.recording import Inputs, Recording, RecordingWriter, fold_log
from pmpnbp.recording.inputs import model_zip
from pmpnbp.recording.schema import APPLICATION_ID, pack, unpack
from pmpnbp.scene import meshes
from pmpnbp.scene.prior import GaussianPrior, UniformPrior
from pmpnbp.scene.scan_files import load_scan
from pmpnbp.scene.urdf import load_model
from pmpnbp.settings import changed, preset
from tests.sameness import assert_same

ROOT = Path(__file__).resolve().parent.parent
CABINET = ROOT / "sample_data" / "cabinet"
# Small enough to be quick: what is recorded has the same form.
SMALL = {"image_width": 80, "triangles": 60, "splat_points": 64}
SEARCHED = {"search_proposals": 300, "search_islands": 1, "search_restarts": 0}
QUICK = SMALL | SEARCHED | {"search_iterations": 2, "anneal_iterations": 2, "refine_iterations": 1}

Iterations = list[tuple[IterationReport, State]]


def inputs_of(prior: str = "uniform", method: str = "pmpnbp", **changes: Any) -> Inputs:
    scans = tuple(
        load_scan(CABINET / scene / "depth.png", CABINET / scene / "camera.json") for scene in ("open", "second_view")
    )
    roi = np.array(json.loads((CABINET / "open" / "roi.json").read_text())["roi"])
    known = GaussianPrior(
        "drawer1",
        np.array([0.6, 0.4, 0.6, *poses.from_rpy([0.01, 0.02, 0.5])]),
        np.full(3, 0.08),
        np.full(3, 0.15),
        {"slide1": (0.2, 0.03)},
    )
    settings = changed(preset("robust"), QUICK | changes)
    return Inputs(
        CABINET / "cabinet.urdf", scans, roi, UniformPrior() if prior == "uniform" else known, settings, 40, 11, method
    )


def iterations_of(inputs: Inputs, count: int) -> tuple[Any, Iterations]:
    problem = inputs.problem()
    state, report = run.begin(problem)
    made = [(report, state)]
    for _ in range(count):
        state, report = run.advance(state, problem)
        made.append((report, state))
    return problem, made


def recorded(path: Path, inputs: Inputs, problem: Any, made: Iterations, **options: Any) -> Path:
    with RecordingWriter(path, inputs, problem.mrf.model, **options) as writer:
        for report, state in made:
            writer.write(report, state)
    return path


@pytest.fixture(scope="module")
def uniform() -> tuple[Inputs, Any, Iterations]:
    inputs = inputs_of()
    return inputs, *iterations_of(inputs, 6)


@pytest.fixture(scope="module")
def path(uniform: tuple[Inputs, Any, Iterations], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return recorded(tmp_path_factory.mktemp("recordings") / "run.sqlite", *uniform)


@pytest.mark.parametrize("given", ["0", "-1", "1e999", '"wide"', "[]", "null", "{"])
def test_what_a_recording_says_is_certain_is_a_number_of_metres(path: Path, tmp_path: Path, given: str) -> None:
    copy = Path(shutil.copy(path, tmp_path / "copy.sqlite"))
    with Recording(copy) as recording:
        assert recording.max_std() == recording.inputs()["max_std"] == 0.0025
    with sqlite3.connect(copy) as connection:
        connection.execute("UPDATE inputs SET value = ? WHERE name = 'max_std'", (given,))
    connection.close()
    with Recording(copy) as recording, pytest.raises(RecordingError, match="its inputs cannot be read"):
        recording.max_std()


@pytest.mark.parametrize(
    ("prior", "changes"),
    [
        ("uniform", {"method": "particle_filter"}),
        ("gaussian", {"method": "particle_filter", "object_estimate": False, "search_iterations": 0}),
        ("uniform", {}),
        ("gaussian", {}),
        ("uniform", {"preset": "paper"}),
        ("uniform", {"preset": "paper", "messages_keep_unary": False, "search_iterations": 2}),
        ("gaussian", {"belief_product": "pooled"}),
        ("gaussian", {"depth_scale_std": 0.01, "camera_std": 0.01, "size_std": 0.01}),
    ],
)
def test_any_iteration_can_be_done_again_from_the_file_alone(prior: str, changes: dict, tmp_path: Path) -> None:
    inputs = inputs_of(prior, **changes)
    if changes.get("preset") == "paper":  # QUICK would have undone the preset's own schedule
        own = SMALL | SEARCHED | {name: value for name, value in changes.items() if name != "preset"}
        inputs = replace(inputs, settings=changed(preset("paper"), own))
    problem, made = iterations_of(inputs, 5)
    with Recording(recorded(tmp_path / "run.sqlite", inputs, problem, made)) as recording:
        assert recording.iterations() == [0, 1, 2, 3, 4, 5]
        for report, state in made:
            assert_same(recording.report(report.iteration), report)
            assert_same(recording.state(report.iteration), state)
        again = recording.problem()
        for k in range(5):
            state, report = run.advance(recording.state(k), again)
            assert_same(state, made[k + 1][1])
            assert_same(report, made[k + 1][0], without=("seconds",))


def test_inputs_come_back(path: Path, uniform: tuple[Inputs, Any, Iterations], tmp_path: Path) -> None:
    inputs = uniform[0]
    with Recording(path) as recording:
        found = recording.restored_inputs(tmp_path)
        members = recording.inputs()
        assert recording.settings() == inputs.settings
        assert recording.parts == ("frame", "drawer1", "drawer2", "drawer3")
    assert_same(found, replace(inputs, model=found.model), without=("scans",))
    for mine, theirs in zip(found.scans, inputs.scans, strict=True):
        assert_same(mine, theirs)
    assert (members["model"], members["method"], members["seed"], members["particles"]) == ("cabinet", "pmpnbp", 11, 40)
    assert members["region"] == inputs.roi.tolist()  # type: ignore[union-attr]


def test_an_iteration_that_is_not_there_is_named(path: Path) -> None:
    with (
        Recording(path) as recording,
        pytest.raises(RecordingError, match=r"iteration 7 is not in recording 'run.sqlite'; it has iterations 0 to"),
    ):
        recording.report(7)


def test_it_can_be_read_while_it_is_written(tmp_path: Path, uniform: tuple[Inputs, Any, Iterations]) -> None:
    inputs, problem, made = uniform
    path = tmp_path / "run.sqlite"
    with RecordingWriter(path, inputs, problem.mrf.model) as writer, Recording(path) as recording:
        assert recording.iterations() == []
        for k, (report, state) in enumerate(made):
            writer.write(report, state)
            patience = time.monotonic() + 600
            while len(recording.iterations()) <= k and time.monotonic() < patience:
                time.sleep(0.002)
            assert_same(recording.report(k), report)
        assert not fold_log(path)  # its writer is alive
    with Recording(path) as recording:
        assert len(recording.iterations()) == len(made)


def test_closed_it_is_one_file(path: Path) -> None:
    assert [file.name for file in path.parent.iterdir()] == [path.name]


@pytest.mark.parametrize("delay", [0.0, 0.02, 0.3])
def test_a_kill_at_any_instant_leaves_whole_iterations(path: Path, tmp_path: Path, delay: float) -> None:
    target = tmp_path / "killed.sqlite"
    program = [
        sys.executable,
        str(ROOT / "tests" / "recording_writer_process.py"),
        str(target),
        str(path),
        str(tmp_path),
    ]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    with subprocess.Popen(program, stdout=subprocess.PIPE, env=environment) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"writing\n"
        time.sleep(delay)
        process.send_signal(signal.SIGKILL)
    assert process.returncode == -signal.SIGKILL
    with Recording(path) as source, Recording(target) as killed:
        there = killed.iterations()
        assert there == list(range(len(there)))
        assert len(there) > 3 or delay < 0.3
        known = source.iterations()
        for k in there[-20:]:
            assert_same(killed.report(k), replace(source.report(known[k % len(known)]), iteration=k))
        assert killed.inputs() == source.inputs()
    assert fold_log(target)
    assert sorted(file.name for file in tmp_path.iterdir()) == ["cabinet.zip", "killed.sqlite"]
    with Recording(target) as folded:
        assert folded.iterations() == there
    check = sqlite3.connect(target)
    assert check.execute("PRAGMA integrity_check").fetchone() == ("ok",)
    check.close()


def test_a_file_cut_short_opens_as_far_as_it_is_whole(path: Path, tmp_path: Path) -> None:
    content = path.read_bytes()
    cut = tmp_path / "cut.sqlite"
    counts = []
    for share in (0.99, 0.9, 0.8, 0.7):
        cut.write_bytes(content[: int(share * len(content))])
        try:
            with Recording(path) as whole, Recording(cut) as recording:
                counts.append(len(recording.iterations()))
                for k in recording.iterations():
                    assert_same(recording.report(k), whole.report(k))
                for k in set(whole.iterations()) - set(recording.iterations()):
                    with pytest.raises(RecordingError, match=r"'cut.sqlite'"):
                        recording.report(k)
        except RecordingError as error:
            assert "damaged" in str(error)
            counts.append(0)
    assert counts == sorted(counts, reverse=True)
    assert 0 < counts[0] < 7


def test_damaged_bytes_are_said_to_be_so(path: Path, tmp_path: Path) -> None:
    damaged = tmp_path / "damaged.sqlite"
    damaged.write_bytes(path.read_bytes())
    connection = sqlite3.connect(damaged)
    connection.execute("UPDATE arrays SET data = x'0011' WHERE iteration = 2 AND name = 'belief.poses'")
    connection.execute("UPDATE arrays SET shape = '[99999999, 99999999]' WHERE iteration = 3 AND name = 'belief.poses'")
    connection.execute("DELETE FROM arrays WHERE iteration = 4 AND name = 'belief.poses'")
    connection.commit()
    connection.close()
    with Recording(damaged) as recording:
        for k in (2, 3, 4):
            with pytest.raises(RecordingError, match=f"'damaged.sqlite' is damaged: iteration {k} cannot be read"):
                recording.report(k)
        recording.report(1)


def test_over_its_size_every_second_is_kept_then_every_fourth(
    tmp_path: Path, uniform: tuple[Inputs, Any, Iterations]
) -> None:
    inputs, problem, made = uniform
    many = [(replace(made[6][0], iteration=number), replace(made[6][1], iteration=number)) for number in range(100)]
    empty = recorded(tmp_path / "empty.sqlite", inputs, problem, []).stat().st_size
    limit = empty + 600_000
    path = recorded(tmp_path / "run.sqlite", inputs, problem, many, max_bytes=limit)
    with Recording(path) as recording:
        there = recording.iterations()
        stride = there[1]
        assert stride in (2, 4, 8, 16, 32)
        assert there == sorted({*range(0, 100, stride), 99})
        assert len(recording.notes()) == np.log2(stride)
        assert f"every {stride}th is kept" in recording.notes()[-1]
        assert_same(recording.report(99), many[99][0])
        with pytest.raises(RecordingError, match=r"iteration 1 of recording 'run.sqlite' was thinned out"):
            recording.report(1)
    assert path.stat().st_size < limit + 200_000


def test_what_is_no_recording_is_refused_in_a_sentence(tmp_path: Path, path: Path) -> None:
    with pytest.raises(RecordingError, match=r"recording 'none.sqlite' is not there"):
        Recording(tmp_path / "none.sqlite")
    text = tmp_path / "text.sqlite"
    text.write_text("not a database, but long enough to have a header of a hundred bytes" * 20)
    with pytest.raises(RecordingError, match=r"'text.sqlite' is not a recording"):
        Recording(text)
    other = tmp_path / "other.sqlite"
    with sqlite3.connect(other) as connection:
        connection.execute("CREATE TABLE mine (x)")
    connection.close()
    with pytest.raises(RecordingError, match=r"'other.sqlite' is not a recording of pmpnbp"):
        Recording(other)
    newer = tmp_path / "newer.sqlite"
    newer.write_bytes(path.read_bytes())
    with sqlite3.connect(newer) as connection:
        connection.execute("PRAGMA user_version = 3")
    connection.close()
    with pytest.raises(RecordingError, match=r"'newer.sqlite' has format 3; this version reads up to 2"):
        Recording(newer)


def test_only_a_recording_is_written_over(tmp_path: Path, uniform: tuple[Inputs, Any, Iterations]) -> None:
    inputs, problem, made = uniform
    precious = tmp_path / "thesis.txt"
    precious.write_text("years of work " * 20)
    with pytest.raises(RecordingError, match=r"'thesis.txt' is there and is no recording"):
        RecordingWriter(precious, inputs, problem.mrf.model)
    assert precious.read_text().startswith("years of work")
    path = recorded(tmp_path / "run.sqlite", inputs, problem, made)
    recorded(path, inputs, problem, made[:2])
    with Recording(path) as recording:
        assert recording.iterations() == [0, 1]
    with pytest.raises(RecordingError, match=r"recording 'run.sqlite' cannot be written"):
        RecordingWriter(tmp_path / "nowhere" / "run.sqlite", inputs, problem.mrf.model)


def test_a_recording_that_is_being_written_is_not_written_over(
    tmp_path: Path, uniform: tuple[Inputs, Any, Iterations]
) -> None:
    inputs, problem, made = uniform
    path = tmp_path / "run.sqlite"
    with RecordingWriter(path, inputs, problem.mrf.model) as writer:
        for count, iteration in enumerate(made):
            with pytest.raises(RecordingError, match=r"recording 'run.sqlite' is still being written"):
                RecordingWriter(path, inputs, problem.mrf.model)
            writer.write(*iteration)
            writer.flush()
            with Recording(path) as recording:
                assert recording.iterations() == list(range(count + 1))
    recorded(path, inputs, problem, made[:1])


def test_what_a_killed_writer_left_is_written_over(tmp_path: Path, uniform: tuple[Inputs, Any, Iterations]) -> None:
    inputs, problem, made = uniform
    with RecordingWriter(tmp_path / "live.sqlite", inputs, problem.mrf.model) as writer:
        writer.write(*made[0])
        writer.flush()
        for end in ("", "-wal"):
            shutil.copy(tmp_path / f"live.sqlite{end}", tmp_path / f"killed.sqlite{end}")
    with Recording(recorded(tmp_path / "killed.sqlite", inputs, problem, made[:2])) as recording:
        assert recording.iterations() == [0, 1]


def test_a_failure_while_writing_reaches_the_inference(tmp_path: Path, uniform: tuple[Inputs, Any, Iterations]) -> None:
    inputs, problem, made = uniform
    writer = RecordingWriter(tmp_path / "run.sqlite", inputs, problem.mrf.model)
    writer.write(*made[0])
    writer.write(*made[0])  # the same number again
    with pytest.raises(RecordingError, match=r"recording 'run.sqlite' cannot be written: UNIQUE"):
        writer.close()


def test_a_urdf_goes_into_the_file_with_the_meshes_it_names(tmp_path: Path) -> None:
    box = meshes.box((0.2, 0.3, 0.4))
    obj = "".join(f"v {x} {y} {z}\n" for x, y, z in box.vertices)
    obj += "".join(f"f {a + 1} {b + 1} {c + 1}\n" for a, b, c in box.faces)
    for folder in ("meshes", "arm_description/meshes"):
        (tmp_path / folder).mkdir(parents=True)
        (tmp_path / folder / "box.obj").write_text(obj)
    link = '<link name="{}"><visual><geometry><mesh filename="{}"/></geometry></visual>{}</link>'
    unused = '<collision><geometry><mesh filename="gone.stl"/></geometry></collision>'
    joint = '<joint name="j" type="continuous"><parent link="a"/><child link="b"/></joint>'
    links = link.format("a", "meshes/box.obj", unused) + link.format(
        "b", "package://arm_description/meshes/box.obj", ""
    )
    (tmp_path / "arm.xml").write_text(f'<robot name="arm">{links}{joint}</robot>')
    (tmp_path / "copy").mkdir()
    zipped = tmp_path / "copy" / "arm.zip"
    zipped.write_bytes(model_zip(tmp_path / "arm.xml"))
    assert model_zip(tmp_path / "arm.xml") == zipped.read_bytes() == model_zip(zipped)
    before, after = load_model(tmp_path / "arm.xml"), load_model(zipped)
    assert before.name == after.name
    for mine, theirs in zip(before.parts, after.parts, strict=True):
        assert_same(mine.inference_mesh, theirs.inference_mesh)
    (tmp_path / "meshes" / "box.obj").unlink()
    with pytest.raises(ModelError, match=r"mesh 'meshes/box.obj' of link 'a' is missing"):
        model_zip(tmp_path / "arm.xml")


@pytest.mark.parametrize("dtype", ["<f8", "<f4", "<i4", "|u1", "|b1"])
@pytest.mark.parametrize("shape", [(), (0,), (3,), (2, 0, 7), (4, 5, 7)])
def test_arrays_come_back_to_the_bit(dtype: str, shape: tuple[int, ...], rng: np.random.Generator) -> None:
    array = (
        rng.integers(0, 2, size=shape).astype(dtype)
        if dtype == "|b1"
        else np.asarray(100 * rng.random(shape), dtype=dtype)
    )
    back = unpack(*pack(array))
    assert (back.dtype, back.shape, back.tobytes()) == (array.dtype, array.shape, array.tobytes())


def test_nan_and_minus_zero_come_back() -> None:
    array = np.array([np.nan, -0.0, np.inf, 5e-324])
    assert unpack(*pack(array)).tobytes() == array.tobytes()


def test_the_header_names_the_format(path: Path) -> None:
    assert path.read_bytes()[68:72] == APPLICATION_ID.to_bytes(4, "big") == b"pmpn"
