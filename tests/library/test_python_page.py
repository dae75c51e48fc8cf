"""Does every block of docs/python.md run as it stands, and print what the page says?"""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.shown_code import blocks, with_samples


def test_every_block_runs(
    repository: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(with_samples(tmp_path))
    shown = blocks(repository / "docs" / "python.md")
    assert [kind for kind, _ in shown].count("python") == 6
    names: dict[str, object] = {}
    printed = ""
    for kind, block in shown:
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
