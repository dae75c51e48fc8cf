"""How much memory does an estimate take? The peak of a process of its own that does one, and of its imports alone.

`python -m benchmarks.peak_memory` is that process; `measure` starts it and reads what it prints.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
from pathlib import Path

from benchmarks.trials import PROJECT


def peak_megabytes() -> float:
    """Peak resident memory of this process so far.

    Linux's own counter is read where there is one: what getrusage says there begins with the memory of the process that
    started this one.
    """
    status = Path("/proc/self/status")
    if status.is_file():
        line = next(line for line in status.read_text().splitlines() if line.startswith("VmHWM"))
        return int(line.split()[1]) / 1024.0
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1024.0**2 if sys.platform == "darwin" else 1024.0)


def measure() -> dict[str, float]:
    """Megabytes of a process that looks for the sample cabinet: `imports` alone, and `estimate`, everything."""
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.peak_memory"], cwd=PROJECT, capture_output=True, text=True, check=True
    )
    figures: dict[str, float] = json.loads(done.stdout)
    return figures


def main() -> None:
    """Look for the cabinet of one scene without a prior; print both figures as JSON."""
    from benchmarks.success import load_cabinet
    from benchmarks.trials import run_trial
    from pmpnbp.scene.prior import UniformPrior
    from pmpnbp.settings import preset

    imports = peak_megabytes()
    robust = preset("robust")
    case = load_cabinet("open", True, robust)
    run_trial(case, UniformPrior("upright"), robust, seed=0, iterations=30)
    print(json.dumps({"imports": round(imports, 1), "estimate": round(peak_megabytes(), 1)}))


if __name__ == "__main__":
    main()
