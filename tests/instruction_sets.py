"""Which instructions do the numbers come from, and what would an older processor have made of them?

NumPy, OpenBLAS, numba and the C library each choose code by the processor they find, and results differ in their last
bits. `python -m tests.instruction_sets COMMAND …` runs a command with all four set back to what every x86-64 processor
since 2008 has; `make test` runs the tests of numbers so a second time. On another architecture there is no such common
baseline: it says so and runs nothing.
"""

from __future__ import annotations

import ctypes
import os
import platform
import shlex
import sys
from pathlib import Path

NAME = "PMPNBP_INSTRUCTION_SET"
OWN, BASELINE = "the processor's own", "the old common baseline"
# Tests of what is served, kept, drawn on the page or written down, not of what is computed.
WITHOUT_NUMBERS = (
    "tests/batch",
    "tests/benchmarks",
    "tests/browser",
    "tests/calibrate/test_command.py",
    "tests/client",
    "tests/docs",
    "tests/geometry/test_first_compilation.py",
    "tests/library",
    "tests/pictures/test_palette.py",
    "tests/recording",
    "tests/reproduce/test_experiments.py",
    "tests/reproduce/test_runs.py",
    "tests/runs",
    "tests/scene/test_model_rubbish.py",
    "tests/scene/test_scan_rubbish.py",
    "tests/scene/test_urdf.py",
    "tests/scene/test_urdf_check.py",
    "tests/test_architecture.py",
    "tests/test_deployment.py",
    "tests/test_instruction_sets.py",
    "tests/test_recording.py",
    "tests/test_wheel.py",
    *(
        f"tests/app/test_{name}.py"
        for name in (
            "attacks",
            "bad_systems",
            "behind_a_proxy",
            "bodies",
            "camera",
            "cli",
            "client_files",
            "command_paths",
            "commands_once",
            "compiled_kernels",
            "connections",
            "damaged_documents",
            "estimate_command",
            "event_stream",
            "events",
            "graph",
            "http_manners",
            "idempotency",
            "kept_inputs",
            "killing",
            "labels",
            "memory_returns",
            "memory_room",
            "names_in_paths",
            "open_recordings",
            "openapi",
            "page_cookie",
            "painter",
            "parsers",
            "poisoned_text",
            "problems",
            "recorded",
            "recording_uploads",
            "removed",
            "rest_examples",  # whose decisions are far from their thresholds: test_next_views
            "restarts",
            "security",
            "serve",
            "session_options",
            "session_scans",
            "sessions",
            "standard_streams",
            "store",
            "turns",
            "upload_fuzz",
            "uploads",
            "view_command",
            "view_scene",
            "view_state",
            "viewer_messages",
            "viewer_proxy",
            "views",
            "warm_up",
        )
    ),
)


def current() -> str:
    """The instruction set that this process was started with."""
    return os.environ.get(NAME, OWN)


def numpy_features() -> list[str]:
    """The groups of instructions beyond its own minimum that NumPy chooses code by in this process."""
    import numpy as np

    return list(np.show_config(mode="dicts")["SIMD Extensions"].get("found", []))


def baseline() -> dict[str, str] | None:
    """The environment variables that set dispatch back; None where the processor is no x86-64."""
    if platform.machine().lower() not in ("x86_64", "amd64"):
        return None
    return {
        NAME: BASELINE,
        # By NumPy's own report: to name a feature that it does not choose code by is an error to some of its versions.
        "NPY_DISABLE_CPU_FEATURES": os.environ.get("NPY_DISABLE_CPU_FEATURES") or " ".join(numpy_features()),
        "OPENBLAS_CORETYPE": "Nehalem",
        "NUMBA_CPU_NAME": "x86-64-v2",  # the same instructions; a target of the image, too
        "NUMBA_CPU_FEATURES": "",
        "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-FMA4,-AVX512F",
        # Beside what is compiled for this processor, never among it.
        "NUMBA_CACHE_DIR": str(Path(__file__).resolve().parent / "__pycache__" / "baseline_kernels"),
    }


def environment(name: str) -> dict[str, str] | None:
    """The whole environment of a process under the set `name`; None where there is no such set here."""
    settings = baseline()
    if name == current():
        return dict(os.environ)
    if settings is None or name == BASELINE:
        return None if settings is None else os.environ | settings
    return {variable: value for variable, value in os.environ.items() if variable not in settings}


def numba_processor() -> str:
    """The processor that numba compiles for, and the instructions beyond that processor's that it may use."""
    import numba
    from llvmlite import binding

    name = numba.config.CPU_NAME or binding.get_host_cpu_name()
    features = numba.config.CPU_FEATURES
    if features is None:
        on = [feature for feature, there in binding.get_host_cpu_features().items() if there]
        features = " ".join(feature for feature in ("avx", "avx2", "fma", "avx512f", "neon", "sve") if feature in on)
    return f"{name} {features}".strip()


def blas_core() -> str:
    """The kind of core that NumPy's OpenBLAS chose its kernels for."""
    import numpy as np

    for library in (Path(np.__file__).parent.parent / "numpy.libs").glob("*openblas*"):
        for symbol in ("scipy_openblas_get_corename64_", "openblas_get_corename64_", "openblas_get_corename"):
            function = getattr(ctypes.CDLL(str(library)), symbol, None)
            if function is not None:
                function.restype = ctypes.c_char_p
                return function().decode()
    return "not OpenBLAS"


def main(command: list[str]) -> int:
    """Become `command` under the baseline."""
    settings = environment(BASELINE)
    if settings is None:
        sys.stdout.write(f"{platform.machine()} has no older instruction set to go back to: no second pass\n")
        return 0
    sys.stdout.write(f"Under {BASELINE}: {shlex.join(command)}\n")
    sys.stdout.flush()
    os.execvpe(command[0], command, settings)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
