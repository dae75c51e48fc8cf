"""Does every block of docs/batch.md run as it stands?"""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from app.cli import main
from pmpnbp.batch import run as run_module
from pmpnbp.batch.manifest import read_manifest
from tests.reproduce.example_runs import run_here
from tests.shown_code import CABINET, blocks, commands, with_samples

# Of a folder of scenes, as many as its example is tried with.
SCENES = ("open", "closed")


def test_every_block_runs(
    repository: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(run_module, "spread", run_here)
    monkeypatch.chdir(with_samples(tmp_path))
    for scene in SCENES:
        shutil.copytree(CABINET / scene, tmp_path / "sample_data" / "cabinet" / scene)
    shutil.copy(CABINET / "cabinet.urdf", tmp_path / "sample_data" / "cabinet")
    shown = blocks(repository / "docs" / "batch.md")
    assert sorted(language for language, _ in shown) == ["python", "sh", "sh", "text", "text"]
    for language, text in shown:
        if language == "text" and text.startswith("{"):
            Path("scans.jsonl").write_text(text)
            assert [len(row.scans) for row in read_manifest(Path("scans.jsonl"))] == [1, 2]
        elif language == "text":
            Path("scans.csv").write_text(text)
        elif language == "python":
            exec(compile(text, "docs/batch.md", "exec"), {})
        else:
            for words in commands(text):
                assert main(words[1:]) == 0
    assert {path.name for path in Path("found").iterdir()} >= {"report.html", "table.csv", "results", "pictures"}
    assert {path.stem for path in Path("scenes", "results").iterdir()} == set(SCENES)
    assert "another seed is made\n" in capsys.readouterr().out
