"""Does the help of every command end with an example that can be typed as it stands?"""

from __future__ import annotations

import argparse
from pathlib import Path

import pytest

from app import cli
from tests.shown_code import commands


def subcommands() -> dict[str, argparse.ArgumentParser]:
    """Every command's parser, by its name."""
    found: dict[str, argparse.ArgumentParser] = {}
    for action in cli._parser()._actions:
        if isinstance(action, argparse._SubParsersAction):
            found |= action.choices
    return found


def shown(text: str) -> list[list[str]]:
    """Words of the calls that a help shows."""
    _, separator, example = text.partition("\nexample")
    assert separator, "no example"
    indented = "\n".join(line[2:] for line in example.splitlines()[1:] if line.startswith("  "))
    return list(commands(indented))


@pytest.mark.parametrize("name", subcommands())
def test_an_example_that_the_command_line_takes(
    name: str, repository: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(repository)
    assert cli.main([name, "--help"]) == 0
    calls = shown(capsys.readouterr().out)
    assert name in [words[1] for words in calls]
    for words in calls:
        assert words[0] == "pmpnbp"
        cli._parse(words[1:])
        assert all(Path(word).exists() for word in words if word.startswith("sample_data/"))


@pytest.mark.parametrize(
    "example", ["pmpnbp estimate", "pmpnbp view a.sqlite --fast", "pmpnbp reproduce everything", "pmpnbp plot"]
)
def test_one_that_it_does_not_take_is_seen(example: str, capsys: pytest.CaptureFixture[str]) -> None:
    (words,) = shown(f"usage: …\n\nexample:\n  {example} # as it is\n")
    with pytest.raises(SystemExit):
        cli._parse(words[1:])
    with pytest.raises(AssertionError, match="no example"):
        shown("usage: …\n")


def test_paragraphs_are_wrapped_and_examples_are_not(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    assert cli.main(["calibrate", "--help"]) == 0
    text, _, example = capsys.readouterr().out.partition("\nexample")
    assert max(map(len, text.splitlines())) <= 80
    assert max(map(len, example.splitlines())) > 80
