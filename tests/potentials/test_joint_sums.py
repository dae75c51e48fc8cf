"""The fused sums over a neighbour's message equal their NumPy specification, and both the pairwise potential's sum."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numba
import numpy as np
import pytest
from numpy.typing import NDArray

from pmpnbp.geometry import poses
from pmpnbp.potentials.kernels import joint_sums as kernel
from pmpnbp.potentials.kernels.joint_sums import (
    LIMITS,
    LIMITS_SLIDE,
    LIMITS_TURN,
    PRISMATIC,
    REVOLUTE,
    Jobs,
    joint_sums,
)
from pmpnbp.potentials.kernels.joint_sums_reference import joint_sums_reference
from pmpnbp.potentials.pairwise import Form, edge_table, log_potential, neighbour_sums, sample_relative
from pmpnbp.scene.articulated_object import Edge

Array = NDArray[np.float64]
FORMS: tuple[Form, ...] = ("limits", "projected")
# What the docstring of `neighbour_sums` promises, and above which result. Of twelve seeds the largest error is 0.93e-3
# with AVX2 and 1.00e-3 without: single precision is added up in another order.
TOLERANCE, FLOOR = 2e-3, -40.0


def random_poses(rng: np.random.Generator, shape: tuple[int, ...]) -> Array:
    return np.concatenate([0.3 * rng.normal(size=(*shape, 3)), poses.random_quaternions(rng, shape)], axis=-1)


def make_edge(
    rng: np.random.Generator, revolute: list[bool], lower: list[float], upper: list[float], at_joint: bool = False
) -> Edge:
    """An edge with a random layout; `at_joint` puts the child's origin on the last axis, as most URDF files do."""
    count = len(revolute)
    axes = rng.normal(size=(count, 3))
    return Edge(
        0,
        1,
        random_poses(rng, (count,)),
        poses.IDENTITY if at_joint else random_poses(rng, ()),
        np.array(revolute),
        axes / np.linalg.norm(axes, axis=-1, keepdims=True),
        np.array(lower, dtype=float),
        np.array(upper, dtype=float),
        np.zeros(count, dtype=np.bool_),
        np.arange(count),
        np.ones(count),
        np.zeros(count),
    )


EDGES = (
    ([False], [-0.1], [0.4], False),
    ([True], [-0.5], [2.0], True),
    ([True], [-0.5], [2.0], False),
    ([True], [-1.0], [4.0], False),
    ([True], [-np.pi], [np.pi], True),
    ([True], [-6.0], [1.0], False),
    ([False], [0.2], [0.2], False),
)


def message_pair(
    rng: np.random.Generator, edge: Edge, s_is_parent: bool, samples: tuple[int, int], spread: float = 1.0
) -> tuple[Array, Array, Array]:
    """Samples of s round one place 2 m from the world's origin, of t through the joint from there, and log weights."""
    middle = np.concatenate([[1.0, -1.2, 1.3], poses.random_quaternions(rng, ())])
    relative = sample_relative(rng, edge, (samples[1],))
    t = poses.multiply(middle, relative if s_is_parent else poses.inverse(relative))

    def scattered(pose: Array, count: int) -> Array:
        step = spread * rng.normal(size=(2, count, 3))
        return poses.perturb(np.broadcast_to(pose, (count, 7)), 0.01 * step[0], 0.04 * step[1])

    return scattered(middle, samples[0]), scattered(t, samples[1]), np.log(rng.dirichlet(np.ones(samples[1])))


def assert_agrees(got: Array, expected: Array) -> None:
    assert got.shape == expected.shape
    near = expected > FLOOR
    assert near.any()
    np.testing.assert_allclose(got[near], expected[near], atol=TOLERANCE, rtol=0)
    assert not np.isnan(got).any()
    assert np.all(got[~near] < FLOOR + TOLERANCE)


def random_jobs(rng: np.random.Generator, kind: int, s_is_parent: bool, samples: tuple[int, int] = (30, 45)) -> Jobs:
    """Three jobs of one kind on random joints, each with samples that fit it to about a standard deviation."""
    lists: dict[str, list[Array]] = {"s": [], "t": [], "fs": [], "ft": [], "second": [], "shape": [], "w": []}
    for _ in range(3):
        at_joint = kind == LIMITS_TURN
        edge = make_edge(rng, [kind not in (PRISMATIC, LIMITS_SLIDE)], [-0.3], [0.9], at_joint)
        table = edge_table([edge])
        s, t, log_weights = message_pair(rng, edge, s_is_parent, samples)
        if kind >= LIMITS:
            ends, shape = (table.lower[0], poses.IDENTITY), table.limits_distance[0]
        else:
            ends, shape = (table.frame_parent[0], table.frame_child[0]), table.shape[0]
        ends = ends if s_is_parent else ends[::-1]
        for name, value in zip(lists, (s, t, *ends, table.upper[0], shape, log_weights), strict=True):
            lists[name].append(value)
    stacked = {name: np.stack(values) for name, values in lists.items()}
    return Jobs(
        np.full(3, kind, np.int32),
        np.full(3, s_is_parent),
        stacked["fs"],
        stacked["ft"],
        stacked["second"],
        stacked["shape"].astype(np.float32),
        stacked["s"],
        stacked["t"],
        stacked["w"],
        np.zeros((3, samples[0]), np.int32),
        np.full((3, samples[0]), samples[1], np.int32),
    )


@pytest.mark.parametrize("s_is_parent", [True, False])
@pytest.mark.parametrize("kind", [PRISMATIC, REVOLUTE, LIMITS, LIMITS_SLIDE, LIMITS_TURN])
@pytest.mark.parametrize("sigmas", [(0.01, 0.05), (0.002, 0.05), (0.1, 0.5)])
def test_the_kernel_does_what_the_specification_says(
    rng: np.random.Generator, kind: int, s_is_parent: bool, sigmas: tuple[float, float]
) -> None:
    jobs = random_jobs(rng, kind, s_is_parent)
    jobs.start[1], jobs.stop[1] = 7, 20
    jobs.start[2, 3], jobs.stop[2, 3] = 5, 5
    got, expected = joint_sums(jobs, *sigmas), joint_sums_reference(jobs, *sigmas)
    assert_agrees(got, expected)
    assert got[2, 3] == -np.inf


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("s_is_parent", [True, False])
def test_the_sums_are_those_of_the_potential(rng: np.random.Generator, form: Form, s_is_parent: bool) -> None:
    edges = [make_edge(rng, *layout) for layout in EDGES]
    data = [message_pair(rng, edge, s_is_parent, (60, 70)) for edge in edges]
    s, t, log_weights = (np.stack(values) for values in zip(*data, strict=True))
    sigmas = {"sigma_position": 0.01, "sigma_orientation": 0.05}
    got = neighbour_sums(
        edge_table(edges),
        np.arange(len(edges)),
        np.full(len(edges), s_is_parent),
        s,
        t,
        log_weights,
        form=form,
        **sigmas,
    )
    for q, edge in enumerate(edges):
        parent, child = (s[q][:, None], t[q]) if s_is_parent else (t[q], s[q][:, None])
        log_psi = log_potential(edge, parent, child, form=form, **sigmas)
        expected = np.logaddexp.reduce(log_weights[q] + log_psi, axis=1)
        near = expected > FLOOR
        np.testing.assert_allclose(got[q, near], expected[near], atol=TOLERANCE, rtol=0)
        assert near.any() or form == "limits"  # eq. 11 forbids the inside of a range beyond half a turn


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("s_is_parent", [True, False])
def test_chains_and_single_axes_go_through_one_call(rng: np.random.Generator, form: Form, s_is_parent: bool) -> None:
    edges = [make_edge(rng, [True, False], [-0.5, -0.2], [0.7, 0.2]), make_edge(rng, [True], [-0.5], [0.7])]
    data = [message_pair(rng, edge, s_is_parent, (20, 25)) for edge in edges]
    s, t, log_weights = (np.stack(values) for values in zip(*data, strict=True))
    sigmas = {"sigma_position": 0.01, "sigma_orientation": 0.05}
    islands_s, islands_t = np.arange(40).reshape(2, 20) % 3, np.arange(50).reshape(2, 25) % 2
    got = neighbour_sums(
        edge_table(edges),
        np.array([0, 1]),
        np.array([s_is_parent] * 2),
        s,
        t,
        log_weights,
        form=form,
        islands_s=islands_s.astype(np.int32),
        islands_t=islands_t.astype(np.int32),
        **sigmas,
    )
    for q, edge in enumerate(edges):
        parent, child = (s[q][:, None], t[q]) if s_is_parent else (t[q], s[q][:, None])
        log_psi = log_potential(edge, parent, child, form=form, **sigmas)
        log_psi = np.where(islands_s[q][:, None] == islands_t[q], log_psi, -np.inf)
        expected = np.logaddexp.reduce(log_weights[q] + log_psi, axis=1)
        assert_agrees(got[q], expected)
        np.testing.assert_array_equal(got[q] == -np.inf, islands_s[q] == 2)


@pytest.mark.parametrize("form", FORMS)
def test_islands_do_not_meet(rng: np.random.Generator, form: Form) -> None:
    edge = make_edge(rng, *EDGES[0])
    s, t, log_weights = message_pair(rng, edge, True, (50, 64))
    islands_s = rng.integers(0, 5, 50).astype(np.int32)
    islands_t = rng.integers(0, 4, 64).astype(np.int32)  # nobody lives on island 4
    table, options = edge_table([edge]), {"form": form, "sigma_position": 0.01, "sigma_orientation": 0.05}
    got = neighbour_sums(
        table,
        np.array([0]),
        np.array([True]),
        s[None],
        t[None],
        log_weights[None],
        islands_s=islands_s[None],
        islands_t=islands_t[None],
        **options,
    )[0]
    for island in range(5):
        here, there = islands_s == island, islands_t == island
        if there.any():
            alone = neighbour_sums(
                table,
                np.array([0]),
                np.array([True]),
                s[None, here],
                t[None, there],
                log_weights[None, there],
                **options,
            )[0]
            np.testing.assert_allclose(got[here], alone, atol=1e-4)
        else:
            assert np.all(got[here] == -np.inf)
    assert np.isfinite(got).any()


def one_job(
    edge: Edge, s: Array, t: Array, log_weights: Array, form: Form = "projected", s_is_parent: bool = True
) -> Array:
    return neighbour_sums(
        edge_table([edge]),
        np.array([0]),
        np.array([s_is_parent]),
        s[None],
        t[None],
        log_weights[None],
        form=form,
        sigma_position=0.01,
        sigma_orientation=0.05,
    )[0]


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("layout", EDGES[:3])
def test_far_apart_is_very_unlikely_but_a_number(
    rng: np.random.Generator, form: Form, layout: tuple[list[bool], list[float], list[float], bool]
) -> None:
    edge = make_edge(rng, *layout)
    s, t, log_weights = message_pair(rng, edge, True, (30, 40))
    away = t + np.array([300.0, 0, 0, 0, 0, 0, 0])
    got = one_job(edge, s, away, log_weights, form)
    log_psi = log_potential(edge, s[:, None], away, form=form, sigma_position=0.01, sigma_orientation=0.05)
    np.testing.assert_allclose(got, np.logaddexp.reduce(log_weights + log_psi, axis=1), rtol=1e-4)
    assert np.all(np.isfinite(got))


def test_weights_of_zero_do_not_count(rng: np.random.Generator) -> None:
    edge = make_edge(rng, *EDGES[1])
    s, t, log_weights = message_pair(rng, edge, True, (30, 40))
    some = np.where(np.arange(40) < 10, log_weights, -np.inf)
    np.testing.assert_allclose(one_job(edge, s, t, some), one_job(edge, s, t[:10], log_weights[:10]), atol=1e-4)
    assert np.all(one_job(edge, s, t, np.full(40, -np.inf)) == -np.inf)


def test_one_good_partner_among_hopeless_ones_is_found(rng: np.random.Generator) -> None:
    edge = make_edge(rng, *EDGES[0])
    s, t, _ = message_pair(rng, edge, True, (1, 400), spread=0.0)
    t[:, :3] += 5.0
    t[217, :3] -= 5.0
    np.testing.assert_allclose(one_job(edge, s, t, np.full(400, -np.log(400))), -np.log(400), atol=TOLERANCE)


def test_a_common_factor_of_the_weights_comes_out(rng: np.random.Generator) -> None:
    edge = make_edge(rng, *EDGES[2])
    s, t, log_weights = message_pair(rng, edge, False, (30, 40))
    here = one_job(edge, s, t, log_weights, s_is_parent=False)
    for shift in (-700.0, 3.0, 700.0):
        there = one_job(edge, s, t, log_weights + shift, s_is_parent=False)
        np.testing.assert_allclose(there - shift, here, atol=1e-4)


def test_nothing_to_sum_over() -> None:
    edge = make_edge(np.random.default_rng(1), *EDGES[0])
    none = np.zeros((0, 7))
    assert one_job(edge, none, none, np.zeros(0)).shape == (0,)
    np.testing.assert_array_equal(one_job(edge, poses.IDENTITY[None], none, np.zeros(0)), [-np.inf])


def many_jobs(rng: np.random.Generator) -> dict[str, object]:
    edges = [make_edge(rng, *layout) for layout in EDGES[:3]]
    data = [message_pair(rng, edge, True, (200, 900)) for edge in edges]
    s, t, log_weights = (np.stack(values) for values in zip(*data, strict=True))
    assert s.shape[0] * s.shape[1] * t.shape[1] >= kernel._PARALLEL_FROM
    return {
        "table": edge_table(edges),
        "edge": np.arange(3),
        "s_is_parent": np.ones(3, np.bool_),
        "poses_s": s,
        "poses_t": t,
        "log_weights_t": log_weights,
        "sigma_position": 0.01,
        "sigma_orientation": 0.05,
    }


@pytest.mark.parametrize("form", FORMS)
def test_the_number_of_threads_changes_no_bit(
    rng: np.random.Generator, form: Form, monkeypatch: pytest.MonkeyPatch
) -> None:
    jobs, before = many_jobs(rng), numba.get_num_threads()
    results = []
    try:
        for threads in range(1, before + 1):
            numba.set_num_threads(threads)
            results.append(neighbour_sums(form=form, **jobs))  # type: ignore[arg-type]
    finally:
        numba.set_num_threads(before)
    monkeypatch.setattr(kernel, "_PARALLEL_FROM", 10**12)
    # Compiled apart, the loop without threads may round differently.
    np.testing.assert_allclose(neighbour_sums(form=form, **jobs), results[0], atol=1e-5)  # type: ignore[arg-type]
    assert np.isfinite(results[0]).any()
    for other in results[1:]:
        np.testing.assert_array_equal(other, results[0])


def test_two_python_threads_may_sum_at_once(rng: np.random.Generator) -> None:
    jobs = many_jobs(rng)
    expected = neighbour_sums(form="projected", **jobs)  # type: ignore[arg-type]
    with ThreadPoolExecutor(2) as pool:
        futures = [pool.submit(neighbour_sums, form="projected", **jobs) for _ in range(20)]  # type: ignore[arg-type]
        for future in futures:
            np.testing.assert_array_equal(future.result(), expected)


def test_read_only_beliefs_are_taken_as_they_are(rng: np.random.Generator) -> None:
    edge = make_edge(rng, *EDGES[1])
    s, t, log_weights = message_pair(rng, edge, True, (30, 40))
    expected = one_job(edge, s, t, log_weights)
    copies = [array.copy() for array in (s, t, log_weights)]
    for array in (s, t, log_weights):
        array.setflags(write=False)
    np.testing.assert_array_equal(one_job(edge, s, t, log_weights), expected)
    for array, copy in zip((s, t, log_weights), copies, strict=True):
        np.testing.assert_array_equal(array, copy)
