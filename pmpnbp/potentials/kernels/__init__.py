"""The inner loops of the potentials, compiled: arrays and numbers only. `reference.py` says what they compute.

The threading layer is chosen here, before the first parallel launch: numba's fallback, `workqueue`, ends the process
when two Python threads launch parallel kernels at once, as two sessions in one server do.
"""

import numba

numba.config.THREADING_LAYER = "omp"
