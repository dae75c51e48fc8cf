"""How fast is it, how much memory does it take, and how often is it right? Every figure the documentation states.

`run` is behind `pmpnbp benchmark`: speeds and memory, from `kernels`, `inference` and `peak_memory`. Success is
measured by commands of its own, which take longer: `success` on the sample cabinet, `heldout` on random scenes that
nothing was tuned on, `real_data` on scans that are no part of the project, `spread` on a chain whose exact belief is
known.
docs/benchmarks.md says how each is run and what its numbers mean.
"""
