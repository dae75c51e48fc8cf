"""After the warm-up no estimate compiles a kernel, whatever it is asked for."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

# In a process of its own, as other tests have kernels compiled in this one.
SCRIPT = """
import pkgutil, sys
from importlib import import_module
from numba.core.dispatcher import Dispatcher
import pmpnbp.potentials.kernels
from app import cli, warm_up
from pmpnbp.scene import lzf

names = [found.name for found in pkgutil.iter_modules(pmpnbp.potentials.kernels.__path__)]
modules = [lzf, *(import_module(f"pmpnbp.potentials.kernels.{name}") for name in names)]
kernels = {kernel for module in modules for kernel in vars(module).values() if isinstance(kernel, Dispatcher)}


def compiled():
    return {f"{kernel.py_func.__qualname__}{signature}" for kernel in kernels for signature in kernel.signatures}


warm_up.run()
before = compiled()
scene, out = "sample_data/cabinet/open", sys.argv[1]
estimate = ["estimate", "sample_data/cabinet/cabinet.urdf", f"{scene}/depth.png", "--camera", f"{scene}/camera.json",
            "--iterations", "13", "--quiet", "--out", out]
for more in [], ["--prior", f"{scene}/prior.json"], ["--config", "preset=paper"], ["--config", "renderer=rasteriser"]:
    assert cli.main(estimate + more) == 0
new = compiled() - before
assert len(before) > 10, before
assert not new, f"compiled by an estimate, not by the warm-up: {sorted(new)}"
"""


def test_an_estimate_finds_every_kernel_compiled(repository: Path, tmp_path: Path) -> None:
    command = [sys.executable, "-c", SCRIPT, str(tmp_path / "result.json")]
    found = subprocess.run(command, cwd=repository, capture_output=True, text=True)
    assert found.returncode == 0, found.stderr
