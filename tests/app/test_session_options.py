"""Do command line, REST and page take the options of a session from where they are declared?"""

from __future__ import annotations

from dataclasses import fields

from app.cli import main
from app.routes.settings import list_settings
from app.schemas import SessionRequest
from app.sessions.sessions import DEFAULTS
from pmpnbp.settings import METHODS, SessionOptions
from tests.app.command_line import ROOT, Capture

DECLARED = {entry.name: entry for entry in fields(SessionOptions)}


def test_the_command_line_has_every_option_with_its_help_and_default(capsys: Capture) -> None:
    assert main(["estimate", "--help"]) == 0
    text = " ".join(capsys.readouterr().out.split())
    for name, entry in DECLARED.items():
        assert f"--{name.replace('_', '-')} " in text
        assert entry.metadata["help"] + ("" if entry.default is None else f"; default: {entry.default}") in text


def test_a_request_has_every_option_with_its_help_default_and_limits() -> None:
    members = SessionRequest.model_json_schema()["properties"]
    for name, entry in DECLARED.items():
        assert members[name]["default"] == entry.default
        assert members[name]["description"].startswith(entry.metadata["help"])
        if isinstance(entry.default, int):
            assert (members[name]["minimum"], members[name]["maximum"]) == (
                entry.metadata["low"],
                entry.metadata["high"],
            )
    assert members["method"]["enum"] == list(METHODS)
    assert members["max_std"]["exclusiveMinimum"] == 0 and "minimum" not in members["max_std"]


def test_a_session_has_what_a_request_has() -> None:
    known = {name: field.get_default(call_default_factory=True) for name, field in SessionRequest.model_fields.items()}
    assert {name: known[name] for name in DEFAULTS} == DEFAULTS
    assert set(known) == {"model_id", "scan_ids", *DEFAULTS}


def test_the_page_is_told_of_those_that_are_numbers_or_words() -> None:
    listed = {option.name: option for option in list_settings().options}
    assert list(listed) == ["method", "particles", "iterations", "seed", "max_std"]
    for name, option in listed.items():
        assert option.default == DECLARED[name].default
        assert option.low == (None if name == "method" else DECLARED[name].metadata["low"])


def test_a_default_stands_where_it_is_declared_and_nowhere_else() -> None:
    """The limit of what is certain once stood in six places, and a comment had drifted."""
    folders = [ROOT / name for name in ("app", "pmpnbp", "static", "benchmarks")]
    files = [path for folder in folders for suffix in ("py", "js", "html") for path in folder.rglob(f"*.{suffix}")]
    assert len(files) > 200
    number = str(SessionOptions.max_std)
    found = [path.relative_to(ROOT).as_posix() for path in files if number in path.read_text(encoding="utf-8")]
    assert found == ["pmpnbp/settings.py"]
    for name in ("index.html", "session.html"):
        assert str(SessionOptions.particles) not in (ROOT / "static" / name).read_text(encoding="utf-8")
