"""Kernels launched from several Python threads at once, as by two sessions in one server.

In a process of its own: with numba's fallback threading layer the process would not fail but end.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

SCRIPT = """
import threading
import numba
import numpy as np
from pmpnbp.potentials.surfaces import prepare_surfaces
from pmpnbp.potentials.unary import PixelScore, object_scores, unary_scores
from tests.potentials import posed_parts

rng = np.random.default_rng(1)
surfaces = prepare_surfaces(posed_parts.object_of(list(posed_parts.shapes().values())))
eye = posed_parts.Camera(80, 60, 75.0, 73.0, 38.2, 31.3)
truth = posed_parts.random_poses(rng, (4,), np.array([0.0, 0.0, 0.8]), 0.1)
scene = posed_parts.observation([posed_parts.rough_view(rng, eye, surfaces, truth)])
pose = posed_parts.random_poses(rng, (4000,), np.array([0.0, 0.0, 0.8]), 0.1)
part, score = np.arange(4000) % 4, PixelScore()

def work():
    splats = unary_scores(scene, surfaces, part, pose, score)
    drawn = unary_scores(scene, surfaces, part[:200], pose[:200], score, renderer="rasteriser")
    return np.concatenate([splats, drawn, object_scores(scene, surfaces, pose[:200].reshape(50, 4, 7), score)])

expected = work()
together, failures = threading.Barrier(3), []

def session():
    together.wait()
    for _ in range(20):
        if not np.array_equal(work(), expected):
            failures.append("another result")

threads = [threading.Thread(target=session) for _ in range(3)]
for thread in threads: thread.start()
for thread in threads: thread.join()
print(numba.threading_layer(), len(failures))
"""


def test_three_threads_launching_kernels_together_all_get_the_right_scores(repository: Path) -> None:
    done = subprocess.run([sys.executable, "-c", SCRIPT], cwd=repository, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["omp", "0"]
