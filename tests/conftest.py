"""What every test may rely on: a seeded generator, the shared data where it is there, and off-screen rendering."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import settings

from app.memory import keep_for_good
from pmpnbp.importing import many_modules

pytest_plugins = ["tests.machine_facts"]

# Files of few, long tests, the longest first: tens of seconds each on their own. `make test` hands out whole files in
# the order of collection; were these among the last, one core would be left alone with one of them.
LONG_FILES = (
    "tests/reproduce/test_experiments.py",
    "tests/browser",
    "tests/test_wheel.py",
    "tests/calibrate",
    "tests/benchmarks/test_benchmarks.py",
    "tests/app/test_openapi.py",
    "tests/app/test_serve.py",
    "tests/app/test_rest_examples.py",
    "tests/docs/test_examples.py",
    "tests/test_recording.py",
    "tests/app/test_view_command.py",
    "tests/app/test_estimate_command.py",
    "tests/app/test_recorded.py",
    "tests/app/test_restarts.py",
    "tests/app/test_killing.py",
    "tests/inference/test_run.py",
    "tests/inference/test_search.py",
    "tests/readout/test_object_posterior.py",
    "tests/app/test_warm_up.py",
)

# pyrender reads this when it is first imported; without a display every other platform fails.
os.environ.setdefault("PYOPENGL_PLATFORM", "egl")

# A gate must not fail by the luck of the draw, nor because the machine is busy: the same examples every time and no
# deadline. `pytest --hypothesis-profile=search` looks for new counterexamples.
settings.register_profile("gate", deadline=None, derandomize=True, database=None)
settings.register_profile("search", deadline=None, max_examples=2000, print_blob=True)
settings.load_profile("gate")


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[None]:
    """Nobody looks for garbage among what is imported, neither while it is nor later."""
    with many_modules():
        found = yield
    keep_for_good()
    return found


@pytest.hookimpl(wrapper=True)
def pytest_runtest_teardown(item: pytest.Item, nextitem: pytest.Item | None) -> Iterator[None]:
    """Nor among what a file's tests have imported: servers of this process look for it after each session that ends."""
    yield
    if nextitem is not None and nextitem.path != item.path:
        keep_for_good()


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Tests of LONG_FILES before all others; whatever is of one file stays in its order."""
    long = [config.rootpath / path for path in LONG_FILES]

    def place(item: pytest.Item) -> int:
        return next((k for k, path in enumerate(long) if item.path.is_relative_to(path)), len(long))

    items.sort(key=place)


@pytest.fixture
def rng() -> np.random.Generator:
    """A generator with a fixed seed, fresh for each test."""
    return np.random.default_rng(20240501)


@pytest.fixture(scope="session")
def repository() -> Path:
    """The folder that holds pyproject.toml."""
    return Path(__file__).resolve().parent.parent


@pytest.fixture(scope="session")
def shared_data(repository: Path) -> Path:
    """Models and scans that lie beside the checkout and are no part of it; the test skips where they are absent."""
    folder = repository.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip("../shared/data is not there")
    return folder
