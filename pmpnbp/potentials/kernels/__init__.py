"""The inner loops of the potentials, compiled: arrays and numbers only. `reference.py` says what they compute.

The threading layer is chosen here, before the first parallel launch: numba's fallback, `workqueue`, ends the process
when two Python threads launch parallel kernels at once, as two sessions in one server do. `omp` needs the system's
libgomp, whose threads by default wait for each other in a busy loop: with another process on the cores, launches of
0.1 ms were seen to take 8 to 12 ms. Passive waiting, which libgomp reads from the environment as it is loaded, takes
that away and costs some microseconds.

Compiled kernels are kept in a folder named after all the sources here. numba itself notices only that a kernel's own
file has changed, and would go on using what it had compiled together with the old form of another.
"""

import hashlib
import os
from pathlib import Path

import numba


def compiled_folder(sources: Path, parent: Path) -> Path:
    """The folder in `parent` for what is compiled from the Python files of the folder `sources` as they are now."""
    digest = hashlib.sha256()
    for path in sorted(sources.glob("*.py")):
        digest.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    return parent / digest.hexdigest()[:16]


os.environ.setdefault("OMP_WAIT_POLICY", "passive")
numba.config.THREADING_LAYER = "omp"
# NUMBA_CACHE_DIR where it is set; numba falls back to the user's own cache folder where this one cannot be written
numba.config.CACHE_DIR = str(
    compiled_folder(Path(__file__).parent, Path(numba.config.CACHE_DIR or Path(__file__).parent / "__pycache__"))
)
