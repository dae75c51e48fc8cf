"""What describes containers fits the project. No container engine is needed, and none is run."""

from __future__ import annotations

import fnmatch
import json
import re
import shlex
import shutil
import subprocess
import tomllib
from dataclasses import fields
from importlib.metadata import requires
from pathlib import Path
from typing import Any

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from app import compiled_kernels
from app.server_config import ServerConfig, config_from, environment_name
from tests import dockerfile

INSTRUCTIONS = set(
    re.findall(r"\w+", "ADD ARG CMD COPY ENTRYPOINT ENV EXPOSE FROM HEALTHCHECK LABEL RUN SHELL USER VOLUME WORKDIR")
)


@pytest.fixture(scope="module")
def instructions(repository: Path) -> list[tuple[str, str]]:
    """Of the project's Dockerfile, name and argument of each."""
    return dockerfile.instructions((repository / "Dockerfile").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def stages(instructions: list[tuple[str, str]]) -> list[list[tuple[str, str]]]:
    """The instructions, from each FROM on."""
    starts = [place for place, (name, _) in enumerate(instructions) if name == "FROM"]
    return [instructions[start:end] for start, end in zip(starts, [*starts[1:], None], strict=True)]


@pytest.fixture(scope="module")
def environment(instructions: list[tuple[str, str]]) -> dict[str, str]:
    """What ENV sets in any stage."""
    pairs = (word.split("=", 1) for name, rest in instructions if name == "ENV" for word in shlex.split(rest))
    return dict(pairs)


def copied(stage: list[tuple[str, str]]) -> list[tuple[dict[str, str], list[str], str]]:
    """Options, sources and target of each COPY."""
    return [dockerfile.copy_parts(rest) for name, rest in stage if name == "COPY"]


def ignored(path: str, patterns: list[str]) -> bool:
    """Whether .dockerignore leaves a path out: the last pattern that fits it, or a folder above it, decides."""
    left_out = False
    for pattern in patterns:
        plain = pattern.removeprefix("!").removeprefix("**/")
        parts = Path(path).parts
        above = ["/".join(parts[:length]) for length in range(1, len(parts) + 1)]
        names = parts if pattern.startswith("**/") else above
        if any(fnmatch.fnmatchcase(name, plain) for name in names):
            left_out = not pattern.startswith("!")
    return left_out


@pytest.fixture(scope="module")
def patterns(repository: Path) -> list[str]:
    lines = (repository / ".dockerignore").read_text(encoding="utf-8").splitlines()
    return [line for line in lines if line and not line.startswith("#")]


def test_instructions_are_known_and_begin_with_a_base(instructions: list[tuple[str, str]]) -> None:
    assert instructions[0][0] == "FROM"
    assert {name for name, _ in instructions} <= INSTRUCTIONS
    for name, rest in instructions:
        assert rest.strip(), name
        if name == "RUN":
            assert shlex.split(rest)


def test_stages_build_on_what_is_there(stages: list[list[tuple[str, str]]]) -> None:
    """On an image, or on a stage above; copies come from such a stage, too."""
    names: list[str] = []
    for stage in stages:
        words = stage[0][1].split()
        assert re.fullmatch(r"python:3\.\d+-slim-\w+", words[0]) or words[0] in names
        for options, _, _ in copied(stage):
            assert options.get("from", "build") in (*names, "build")
        if len(words) == 3:
            assert words[1] == "AS"
            names.append(words[2])
    assert names == ["base", "build"]


def test_the_base_runs_python_that_the_project_takes(repository: Path, stages: list[list[tuple[str, str]]]) -> None:
    version = re.match(r"python:3\.(\d+)-", stages[0][0][1])
    assert version is not None
    assert int(version[1]) >= 11
    text = (repository / "Dockerfile").read_text(encoding="utf-8")
    assert set(re.findall(r"lib/python(3\.\d+)/", text)) == {f"3.{version[1]}"}


def test_what_is_copied_exists_and_is_not_ignored(
    repository: Path, stages: list[list[tuple[str, str]]], patterns: list[str]
) -> None:
    from_here = [
        source
        for stage in stages
        for options, sources, _ in copied(stage)
        if "from" not in options
        for source in sources
    ]
    assert {"pyproject.toml", "constraints.txt", "pmpnbp", "app", "static", "sample_data", "benchmarks"} <= set(
        from_here
    )
    for source in from_here:
        assert (repository / source).exists(), source
        assert not ignored(source, patterns), source


def test_what_is_copied_from_a_stage_is_made_there(stages: list[list[tuple[str, str]]]) -> None:
    build = " ".join(rest for stage in stages[:2] for _, rest in stage)
    moved = [
        source for options, sources, _ in copied(stages[2]) if options.get("from") == "build" for source in sources
    ]
    assert moved
    for source in moved:
        assert source in build, source


@pytest.mark.parametrize(
    "path",
    [
        ".git/config",
        ".venv/bin/python",
        "tests/conftest.py",
        "app/__pycache__/x.pyc",
        "pmpnbp/scene/__pycache__",
        "docs/rest.md",
        ".env",
        "out/result.json",
    ],
)
def test_nothing_else_gets_into_an_image(path: str, patterns: list[str]) -> None:
    assert ignored(path, patterns)


def test_the_server_runs_as_somebody_who_owns_the_data(stages: list[list[tuple[str, str]]]) -> None:
    last = stages[-1]
    (user,) = [rest for name, rest in last if name == "USER"]
    made = next(rest for name, rest in last if name == "RUN")
    assert user not in ("root", "0")
    assert f"--owner={user}" in made
    assert ("VOLUME", "/data") in last
    assert [name for name, _ in last].index("USER") > [name for name, _ in last].index("RUN")


def test_the_environment_is_one_that_the_server_takes(environment: dict[str, str], stages: Any) -> None:
    known = {environment_name(entry.name) for entry in fields(ServerConfig)}
    assert {name for name in environment if name.startswith("PMPNBP_")} <= known
    config = config_from({}, environment)
    assert (config.host, config.data_dir) == ("0.0.0.0", Path("/data"))
    assert ("EXPOSE", str(config.port)) in stages[-1]
    assert environment["PATH"].startswith("/opt/venv/bin:")
    assert environment["NUMBA_CACHE_DIR"] in " ".join(rest for name, rest in stages[-1] if name == "COPY")


def test_commands_are_lists_that_run_what_there_is(repository: Path, stages: list[list[tuple[str, str]]]) -> None:
    """As text they would run in a shell, which keeps the signal to stop from the server."""
    found = dict(stages[-1])
    assert json.loads(found["ENTRYPOINT"]) == ["pmpnbp"]
    assert json.loads(found["CMD"]) == ["serve"]
    options, _, command = found["HEALTHCHECK"].partition(" CMD ")
    assert all(re.fullmatch(r"--(interval|timeout|start-period|retries)=\d+s?", option) for option in options.split())
    python, flag, script = json.loads(command)
    assert (python, flag) == ("python", "-c")
    compile(script, "health check", "exec")
    assert "/healthz" in script
    modules = re.findall(r"python -m (app\.\w+)", " ".join(rest for _, rest in stages[1]))
    assert modules
    for module in modules:
        assert (repository / (module.replace(".", "/") + ".py")).is_file()


def test_kernels_are_compiled_for_processors_that_the_builder_does_not_know(
    environment: dict[str, str], stages: list[list[tuple[str, str]]]
) -> None:
    """For the common ones, the better one first; by the environment that the server starts with, too."""
    named = environment[compiled_kernels.VARIABLE].split()
    assert named == ["x86-64-v3", "x86-64-v2", "generic"]
    assert set(named) == set(compiled_kernels.NEEDS)
    assert not {"NUMBA_CPU_NAME", "NUMBA_CPU_FEATURES"} & set(environment)
    assert any(name == "ENV" and compiled_kernels.VARIABLE in rest for name, rest in stages[0])
    assert any("python -m app.warm_up" in rest for name, rest in stages[1] if name == "RUN")


def test_packages_that_are_left_out_are_needed_by_nothing_that_stays(
    repository: Path, stages: list[list[tuple[str, str]]]
) -> None:
    """But by Open3D, whose plots are taken out of it, and by trimesh, which says itself that it can do without."""
    run = " ".join(rest for name, rest in stages[1] if name == "RUN")
    lists = re.findall(r"uninstall --quiet --yes ([^&]*)", run)
    left_out = {canonicalize_name(name) for names in lists for name in names.split()}
    assert {"dash", "plotly", "embreex"} <= left_out
    assert "sed -i /draw_plotly/d open3d/visualization/__init__.py" in run
    project = tomllib.loads((repository / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    needed: set[str] = set()
    waiting = [Requirement(text) for text in project["dependencies"]]
    while waiting:
        requirement = waiting.pop()
        name = canonicalize_name(requirement.name)
        there = requirement.marker is None or requirement.marker.evaluate({"extra": ""})
        if there and name not in needed:
            needed.add(name)
            waiting += [Requirement(text) for text in requires(name) or [] if not name.startswith("open3d")]
    assert len(needed) > 30
    assert not needed & left_out


@pytest.mark.skipif(shutil.which("shellcheck") is None, reason="shellcheck is not installed")
def test_scripts_are_clean(repository: Path) -> None:
    scripts = [repository / "docs" / "deployment" / "build_image", *sorted((repository / ".ci").iterdir())]
    assert subprocess.run(["shellcheck", *scripts], stdout=subprocess.PIPE, text=True).stdout == ""


def test_the_script_finds_its_base_in_the_dockerfile(repository: Path) -> None:
    script = (repository / "docs" / "deployment" / "build_image").read_text(encoding="utf-8")
    assert r"s/^FROM \(python:[^ ]*\) AS base$/\1/p" in script
    lines = (repository / "Dockerfile").read_text(encoding="utf-8").splitlines()
    assert len([line for line in lines if re.fullmatch(r"FROM python:[^ ]* AS base", line)]) == 1


def test_the_proxy_is_the_one_way_in(repository: Path) -> None:
    folder = repository / "docs" / "deployment"
    compose = yaml.safe_load((folder / "compose.yaml").read_text(encoding="utf-8"))
    server, proxy = compose["services"]["pmpnbp"], compose["services"]["proxy"]
    assert set(compose["services"]) == {"pmpnbp", "proxy"}
    assert (folder / server["build"]).resolve() == repository
    assert "ports" not in server
    assert (server["read_only"], server["tmpfs"]) == (True, ["/tmp"])
    assert proxy["ports"] == ["443:443"]
    assert compose["networks"]["inside"] == {"internal": True}
    assert server["networks"] == ["inside"]
    assert set(proxy["networks"]) == {"inside", "outside"}
    assert proxy["depends_on"] == {"pmpnbp": {"condition": "service_healthy"}}
    mounted = [volume.split(":") for service in (server, proxy) for volume in service["volumes"]]
    assert {source for source, *_ in mounted if not source.startswith(".")} == set(compose["volumes"])
    for source, target, *_ in mounted:
        if source.startswith("."):
            assert (folder / source).is_file()
            assert target == "/etc/caddy/Caddyfile"
    known = {environment_name(entry.name) for entry in fields(ServerConfig)}
    assert {name for name in server["environment"] if name.startswith("PMPNBP_")} <= known
    assert server["environment"]["PMPNBP_TOKEN"].startswith("${PMPNBP_TOKEN:?")


def test_the_proxy_passes_on_to_the_server(repository: Path, stages: list[list[tuple[str, str]]]) -> None:
    text = (repository / "docs" / "deployment" / "Caddyfile").read_text(encoding="utf-8")
    code = re.sub(r"#.*", "", text)
    assert code.count("{") == code.count("}")
    port = dict(stages[-1])["EXPOSE"]
    assert re.search(rf"reverse_proxy pmpnbp:{port} \{{\s*flush_interval -1\s*\}}", code)
    assert "https://{$PMPNBP_DOMAIN:localhost} {" in code
    limit = re.search(r"max_size (\d+)MiB", code)
    assert limit is not None
    assert int(limit[1]) << 20 > ServerConfig().max_upload_bytes


def test_limits_on_the_page_are_settings(repository: Path) -> None:
    text = (repository / "docs" / "deployment.md").read_text(encoding="utf-8")
    known = {environment_name(entry.name) for entry in fields(ServerConfig)}
    named = set(re.findall(r"PMPNBP_[A-Z_]+[A-Z]", text)) - {"PMPNBP_DOMAIN"}
    assert len(named) > 6
    assert named <= known
