"""Is a session refused that does not fit into memory, with a sentence, and only then?"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from app import memory
from app.problems import HttpProblem
from app.sessions.memory_room import AT_REST, RESERVE, MemoryRoom, estimated_bytes
from pmpnbp import recording
from pmpnbp.inference.problem import Problem
from pmpnbp.scene.scan_files import load_scan
from pmpnbp.settings import changed, preset
from tests.app import small_sessions as small

GIB = 1 << 30


@pytest.fixture(scope="module")
def problem() -> Problem:
    scan = load_scan(small.CABINET / "open" / "depth.png", small.CABINET / "open" / "camera.json")
    settings = changed(preset("robust"), small.QUICK)
    made, _ = recording.prepare(small.CABINET / "cabinet.urdf", [scan], small.ROI, None, settings, particles=40, seed=0)
    return made


def room(most: int | None = None, free: int | None = None, taken: int = 0, running: int = 2) -> MemoryRoom:
    return MemoryRoom(most, running, lambda: free, lambda: taken)


def test_the_estimate_grows_with_what_takes_memory(problem: Problem) -> None:
    least = estimated_bytes(problem)
    for more in ({"search_proposals": 200_000}, {"splat_points": 4096}, {"triangles": 100_000}, {"joint_draws": 256}):
        assert estimated_bytes(replace(problem, settings=changed(problem.settings, more))) > least, more
    assert estimated_bytes(replace(problem, particles=20_000)) > least
    seen = problem.observation
    twice = replace(problem, observation=replace(seen, views=seen.views * 2))
    assert estimated_bytes(twice) > least


def test_what_does_not_fit_is_refused_with_what_there_is(problem: Problem) -> None:
    large = replace(problem, particles=20_000)
    need = estimated_bytes(large)
    for tight in (room(free=need + RESERVE - 1), room(most=need + RESERVE - 1, free=100 * GIB)):
        with pytest.raises(HttpProblem, match="4 parts of 20000 particles") as refused:
            tight.claim("a", large)
        assert refused.value.status == 507
        assert f"there are {(need - 1) // 2**20:,} MiB; ask for fewer particles" in refused.value.detail
        tight.claim("a", problem)
    room(free=need + RESERVE).claim("a", large)
    MemoryRoom(None, 2, lambda: None, lambda: 0).claim("a", large)  # where the system does not tell, nothing is refused


def test_what_other_sessions_will_need_counts(problem: Problem) -> None:
    large = replace(problem, particles=20_000)
    need = estimated_bytes(large)
    both = room(free=2 * need + RESERVE)
    both.claim("a", large)
    both.claim("b", large)
    with pytest.raises(HttpProblem):
        both.claim("c", large)  # a third one waits for its turn, but has its iteration in memory
    both.release("a")
    both.claim("c", large)
    rest = room(free=round((2 + AT_REST) * need) + RESERVE + 1)
    for id in "abc":
        rest.claim(id, large)


def test_another_size_takes_the_place_of_the_one_before(problem: Problem) -> None:
    large = replace(problem, particles=20_000)
    alone = room(free=estimated_bytes(large) + RESERVE)
    for _ in range(3):
        alone.claim("a", large)
    # what is less than before is never refused, however little is left
    tight = MemoryRoom(None, 2, free := Free(estimated_bytes(large) + RESERVE), lambda: 0)
    tight.claim("a", large)
    free.bytes = 0
    tight.claim("a", problem)
    with pytest.raises(HttpProblem):
        tight.claim("a", large)


class Free:
    """What is free, which changes."""

    def __init__(self, count: int) -> None:
        self.bytes = count

    def __call__(self) -> int:
        return self.bytes


def test_a_server_refuses_what_it_has_no_memory_for(serve: Callable[..., Any]) -> None:
    served = serve(max_memory_bytes=memory.resident_bytes() + RESERVE + (300 << 20)).ready()
    client = served.client
    ids = {"model_id": small.upload_model(client), "scan_ids": [small.upload_scan(client)]}
    asked = small.body(ids["model_id"], ids["scan_ids"][0], particles=20_000)
    small.problem(client.post("/api/v1/sessions", json=asked), 507, "ask for fewer particles")
    assert client.get("/api/v1/sessions").json() == []
    path = small.create(client, model_id=ids["model_id"], scan_id=ids["scan_ids"][0])
    before = client.get(path).json()
    answer = client.patch(path, json={"config": {"search_proposals": 200_000}})
    small.problem(answer, 507, "hypotheses of the search")
    assert client.get(path).json() == before
    small.step(client, path)


@pytest.mark.parametrize(
    ("files", "free"),
    [
        ({}, None),
        ({"proc/meminfo": "MemTotal: 9 kB\nMemAvailable:     1000 kB\n"}, 1_024_000),
        (
            {"proc/meminfo": "MemAvailable: 1000 kB", "proc/self/cgroup": "0::/\n", "sys/fs/cgroup/memory.max": "max"},
            1_024_000,
        ),
        (
            {
                "proc/meminfo": "MemAvailable: 1000 kB",
                "proc/self/cgroup": "0::/docker/abc\n",
                "sys/fs/cgroup/memory.max": "5000",
                "sys/fs/cgroup/memory.current": "4000",
                "sys/fs/cgroup/memory.stat": "anon 3000\ninactive_file 700\n",
            },
            1700,
        ),
        (
            {
                "proc/self/cgroup": "3:cpu,cpuacct:/a\n4:memory:/a/b\n",
                "sys/fs/cgroup/memory/a/b/memory.limit_in_bytes": "9223372036854771712",
                "sys/fs/cgroup/memory/a/b/memory.usage_in_bytes": "100",
                "sys/fs/cgroup/memory/a/memory.limit_in_bytes": "1000",
                "sys/fs/cgroup/memory/a/memory.usage_in_bytes": "1200",
            },
            0,
        ),
    ],
)
def test_what_is_free_is_what_machine_and_container_leave(
    tmp_path: Path, files: dict[str, str], free: int | None
) -> None:
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    assert memory.free_bytes(tmp_path) == free
