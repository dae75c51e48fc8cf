"""Does every block of docs/python.md run as it stands, and print what the page says?"""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

SAMPLES = {
    "cabinet.urdf": "cabinet.urdf",
    "depth.png": "open/depth.png",
    "camera.json": "open/camera.json",
    "second.png": "second_view/depth.png",
    "second.json": "second_view/camera.json",
}


def test_every_block_runs(
    repository: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, source in SAMPLES.items():
        shutil.copyfile(repository / "sample_data" / "cabinet" / source, tmp_path / name)
    monkeypatch.chdir(tmp_path)
    text = (repository / "docs" / "python.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```(\w+)\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    assert [kind for kind, _ in blocks].count("python") == 6
    names: dict[str, object] = {}
    printed = ""
    for kind, block in blocks:
        if kind == "python":
            exec(compile(block, "docs/python.md", "exec"), names)
            printed = capsys.readouterr().out
            continue
        # numbers depend on the processor in their last digits
        of_words = re.compile(r"[\d.]+")
        assert of_words.sub("N", printed) == of_words.sub("N", block)
    found, result = names["found"], names["result"]
    assert isinstance(result, dict) and result["fit"] == "good"
    assert found is not None and names["picture"]
