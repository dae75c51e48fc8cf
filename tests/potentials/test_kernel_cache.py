"""Compiled kernels are kept, and not used once any kernel's source has changed."""

from __future__ import annotations

from pathlib import Path

import numba

from pmpnbp.potentials import kernels
from pmpnbp.potentials.kernels import splatting


def test_a_change_in_any_source_leads_to_another_folder(tmp_path: Path) -> None:
    (tmp_path / "one.py").write_text("a = 1\n")
    (tmp_path / "two.py").write_text("b = 1\n")
    before = kernels.compiled_folder(tmp_path, tmp_path)
    assert kernels.compiled_folder(tmp_path, tmp_path) == before
    (tmp_path / "two.py").write_text("b = 2\n")
    changed = kernels.compiled_folder(tmp_path, tmp_path)
    (tmp_path / "two.py").rename(tmp_path / "three.py")
    renamed = kernels.compiled_folder(tmp_path, tmp_path)
    assert len({before, changed, renamed}) == 3


def test_kernels_are_kept_in_that_folder() -> None:
    folder = Path(numba.config.CACHE_DIR)
    assert folder == kernels.compiled_folder(Path(kernels.__file__).parent, folder.parent)
    assert Path(splatting._add_range.stats.cache_path).parent == folder
