"""Do the benchmarks run, and is what they judge by right? Reduced runs; no figure of speed is tested."""

from __future__ import annotations

import json
import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks import generated, heldout, inference, kernels, peak_memory, real_data, run, success
from benchmarks.alignment import offset, rigid_fit
from benchmarks.statistics import wilson
from benchmarks.trials import Trial, load_case, rough_prior
from pmpnbp.geometry import poses
from pmpnbp.scene.urdf import load_model
from pmpnbp.settings import preset

TINY = inference.Plan(
    particles=(50,), parts=(4,), parts_particles=50, repeats=2, scenes=("open",), seeds=1, memory=False
)


@pytest.mark.parametrize(
    ("successes", "trials", "low", "high"),
    [
        # solved by hand: with no success the upper end is z² / (n + z²)
        (0, 10, 0.0, 3.841459 / 13.841459),
        (10, 10, 10 / 13.841459, 1.0),
        # the roots of (p - 1/2)² = z² p (1 - p) / 100
        (50, 100, 0.5 - 0.0961710, 0.5 + 0.0961710),
        (0, 0, 0.0, 1.0),
    ],
)
def test_wilson_interval(successes: int, trials: int, low: float, high: float) -> None:
    assert wilson(successes, trials) == pytest.approx((low, high), abs=2e-4)


def test_wilson_interval_ends_are_where_the_rate_is_a_quantile_away() -> None:
    for end in wilson(31, 50):
        assert abs(31 / 50 - end) == pytest.approx(1.959964 * np.sqrt(end * (1 - end) / 50))


def test_wilson_refuses_more_successes_than_trials() -> None:
    with pytest.raises(ValueError, match="3 successes of 2 trials"):
        wilson(3, 2)


def test_rigid_offset_is_recovered(rng: np.random.Generator) -> None:
    points = [rng.normal(0.0, 0.2, (30, 3)) for _ in range(4)]
    truth = np.concatenate([rng.normal(0.0, 1.0, (4, 3)), poses.random_quaternions(rng, (4,))], axis=1)
    for _ in range(20):
        moved = np.concatenate([rng.normal(0.0, 1.0, 3), poses.random_quaternions(rng, ())])
        found = offset(poses.multiply(poses.inverse(moved), truth), truth, points)
        np.testing.assert_allclose(found[:3], moved[:3], atol=1e-9)
        assert poses.rotation_angle(found[3:], moved[3:]) < 1e-7


def test_rigid_fit_never_mirrors(rng: np.random.Generator) -> None:
    points = rng.normal(0.0, 1.0, (40, 3)) * [1.0, 0.6, 0.3]
    fitted = poses.to_matrix(rigid_fit(points, points * [1.0, 1.0, -1.0]))
    assert np.linalg.det(fitted[:3, :3]) == pytest.approx(1.0)


def test_seconds_to_result_is_when_the_error_falls_for_good() -> None:
    trial = Trial(
        np.zeros(1), np.zeros((1, 7)), np.zeros(0), np.arange(5.0), np.array([0.2, 0.001, 0.02, 0.004, 0.003]), 4
    )
    assert trial.seconds_to_result(0.01) == 3.0
    assert trial.seconds_to_result(0.1) == 1.0
    assert trial.seconds_to_result(0.0001) == float("inf")


def test_true_poses_have_no_error_and_known_shifts_their_length() -> None:
    case = success.load_cabinet("open", True, preset("robust"))
    assert case.errors(case.true_poses).max() < 1e-12
    shifted = case.true_poses + np.eye(7)[0] * 0.03
    np.testing.assert_allclose(case.errors(shifted), 0.03)
    assert case.judged.all()
    assert np.all((case.shares > 0) & (case.shares <= 1))


def test_rough_prior_scatters_as_it_says() -> None:
    """The six standard deviations over 400 draws each lie within 20 % of the stated ones: that is 5.6 of their own
    standard deviations (1 / sqrt(800) each), a false alarm in 10⁷ runs. The seed is fixed."""
    case = success.load_cabinet("closed", True, preset("robust"))
    truth = case.true_links["frame"]
    made = [rough_prior(np.random.default_rng(seed), case, "frame", 0.08, 8.6) for seed in range(400)]
    mean = np.array([prior.pose_world_link for prior in made])
    turn = poses.to_rotation_vector(
        poses.quaternion_multiply(mean[:, 3:], poses.quaternion_conjugate(np.tile(truth[3:], (400, 1))))
    )
    np.testing.assert_allclose((mean - truth)[:, :3].std(axis=0), 0.08, rtol=0.2)
    np.testing.assert_allclose(turn.std(axis=0), np.deg2rad(8.6), rtol=0.2)


@pytest.mark.parametrize("kind", list(generated.KINDS))
@pytest.mark.parametrize("parts", [4, 12])
def test_generated_objects_have_as_many_parts_as_asked_for(kind: str, parts: int) -> None:
    case = generated.generated_case(kind, parts, preset("robust"))
    assert len(case.model.parts) == parts
    assert len(case.observation.points) > 100


def test_a_reduced_run_has_every_figure(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run.main(tmp_path / "figures.json", TINY, lambda: kernels.measure(0.01, (12,), ((80, 60),)))
    figures = json.loads((tmp_path / "figures.json").read_text())
    assert figures["schema"] == "pmpnbp/benchmark-1"
    assert set(figures) == {"schema", "date", "machine", "kernels", "inference"}
    assert figures["machine"]["versions"]["numpy"] == np.__version__
    assert figures["kernels"]["cases"]
    stages = {(case["preset"], stage) for case in figures["inference"]["by_particles"] for stage in case["ms"]}
    assert ("paper", "belief propagation") in stages
    assert {("robust", stage) for stage in ("search", "belief propagation")} <= stages
    for case in [*figures["inference"]["by_particles"], *figures["inference"]["by_parts"]]:
        for stage, milliseconds in case["ms"].items():
            assert case["ratio"][stage] == pytest.approx(milliseconds / case["reference_ms"])
    assert [way["runs"] for way in figures["inference"]["to_convergence"]] == [1, 1]
    captured = capsys.readouterr()
    assert "An iteration by particles" in captured.out
    assert "iterations of preset paper" in captured.err


def test_an_unwritable_output_is_refused_before_measuring(tmp_path: Path) -> None:
    with pytest.raises(run.OutputError, match="expected the name of a file"):
        run.main(tmp_path / "absent" / "figures.json")


def test_what_cannot_be_written_after_all_was_printed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The folder may go while minutes are measured: the figures are not lost, nor is what the file held."""
    place = tmp_path / "folder" / "figures.json"
    place.parent.mkdir()

    def measured(*_: object) -> dict[str, object]:
        place.parent.rmdir()
        return {}

    monkeypatch.setattr(run, "collect", measured)
    monkeypatch.setattr(run, "report", lambda figures: "the figures")
    with pytest.raises(run.OutputError, match="cannot be written: No such file"):
        run.main(place)
    assert capsys.readouterr().out == "the figures\n"


def test_figures_go_through_a_link_and_into_a_pipe(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run, "collect", lambda *_: {"schema": run.SCHEMA})
    monkeypatch.setattr(run, "report", lambda figures: "the figures")
    held = tmp_path / "held.json"
    link, pipe = tmp_path / "link.json", tmp_path / "pipe"
    link.symlink_to(held)
    os.mkfifo(pipe)
    run.main(link)
    assert link.is_symlink() and json.loads(held.read_text()) == {"schema": run.SCHEMA}
    with ThreadPoolExecutor(1) as pool:
        read = pool.submit(pipe.read_text)
        run.main(pipe)
        assert json.loads(read.result()) == {"schema": run.SCHEMA}


def test_peak_memory_is_that_of_this_process() -> None:
    before = peak_memory.peak_megabytes()
    held = np.ones(int(before + 64) * 131072)  # as much again and 64 MB, in float64, every page of it written
    assert peak_memory.peak_megabytes() >= held.nbytes / 2**20


def test_success_and_heldout_report_runs_and_failures(capsys: pytest.CaptureFixture[str]) -> None:
    success.main(["--seeds", "1", "--scenes", "open", "--modes", "rough", "--iterations", "1"])
    printed = capsys.readouterr().out
    assert "| open | " in printed
    assert "| all | " in printed
    success.main(
        ["--seeds", "1", "--scenes", "open", "--modes", "rough", "--particles", "50", "--method", "particle_filter"]
    )
    assert "| open | 1 of 1" in capsys.readouterr().out
    heldout.main(["--cabinets", "0", "--doors", "1", "--chains", "0", "--iterations", "1"])
    printed = capsys.readouterr().out
    assert "| no prior | door | 1 | " in printed
    assert "door_100, no prior, seed 0: " in printed, "one iteration cannot succeed"


def test_real_data_is_skipped_with_a_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    real_data.main([], data=tmp_path)
    printed = capsys.readouterr().out
    assert printed.count("skipped, because the data is not in") == 2


def test_only_links_said_to_be_symmetric_are_judged_by_nearest_points(shared_data: Path) -> None:
    settings = preset("robust")
    model = load_model(shared_data / "real_xarm7" / "model.urdf", triangle_budget=settings.triangles)
    folder = shared_data / "real_xarm7" / "frame_0"
    case = load_case("frame_0", model, folder, None, settings)
    symmetric = [part.name for part, flag in zip(model.parts, case.symmetric, strict=True) if flag]
    assert symmetric == ["link_base", "link7"]
    strict = replace(case, symmetric=np.zeros(len(model.parts), dtype=np.bool_))
    turned = poses.multiply(case.true_poses, poses.from_xyz_rpy([0.0, 0.0, 0.0], [0.0, 0.0, np.pi]))
    assert case.errors(turned)[0] < 0.5 * strict.errors(turned)[0]
