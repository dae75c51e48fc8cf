"""The inner loops of the potentials, compiled: arrays and numbers only. `reference.py` says what they compute.

The threading layer is chosen here, before the first parallel launch: numba's fallback, `workqueue`, ends the process
when two Python threads launch parallel kernels at once, as two sessions in one server do. `omp` needs the system's
libgomp, whose threads by default wait for each other in a busy loop: with another process on the cores, launches of
0.1 ms were seen to take 8 to 12 ms. Passive waiting, which libgomp reads from the environment as it is loaded, takes
that away and costs some microseconds.
"""

import os

import numba

os.environ.setdefault("OMP_WAIT_POLICY", "passive")
numba.config.THREADING_LAYER = "omp"
