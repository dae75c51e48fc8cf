"""What every test may rely on: a seeded generator, the shared data where it is there, and off-screen rendering."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import settings

pytest_plugins = ["tests.machine_facts"]

# pyrender reads this when it is first imported; without a display every other platform fails.
os.environ.setdefault("PYOPENGL_PLATFORM", "egl")

# A gate must not fail by the luck of the draw, nor because the machine is busy: the same examples every time and no
# deadline. `pytest --hypothesis-profile=search` looks for new counterexamples.
settings.register_profile("gate", deadline=None, derandomize=True, database=None)
settings.register_profile("search", deadline=None, max_examples=2000, print_blob=True)
settings.load_profile("gate")


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
