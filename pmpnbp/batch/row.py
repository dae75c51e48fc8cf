"""What is one estimate of a batch made of? A row with its files, region, prior and options, checked member by member.

Files are named relative to the manifest's folder. Whether they are there is asked here; what is in them is told when
the row's turn comes.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, MutableMapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias

from pmpnbp.errors import ManifestError, PmpnbpError
from pmpnbp.names import name_fault
from pmpnbp.scene.json_files import finite_number, read_object
from pmpnbp.settings import changed, checked_option, preset

# Members that are simple options of a session.
OPTIONS = ("method", "particles", "iterations", "seed", "max_std")
MEMBERS = ("name", "model", "scan", "scans", "camera", "roi", "prior", *OPTIONS, "config")
# Bytes of a name: a file's name has room for 255, and ours ends in a suffix.
LONGEST_NAME = 200
# A file, or in its place what it would say.
Source: TypeAlias = Path | Mapping[str, object]


@dataclass(frozen=True, kw_only=True)
class Entry:
    """A row as it was read. where : as sentences begin that tell of it; folder : that its files are relative to
    fault : what keeps it from being read, where something does; members : by name, as JSON has them"""

    where: str
    folder: Path
    members: Mapping[str, Any] = field(default_factory=dict)
    fault: str | None = None


@dataclass(frozen=True, kw_only=True)
class Row:
    """An estimate that is asked for.

    name : that its result is kept by, and no other row's; cameras : none, one for all scans, or one each
    roi : x0 y0 z0 x1 y1 z1, metres, world; options : those of OPTIONS that are given; settings : by name
    """

    name: str
    model: Path
    scans: tuple[Path, ...]
    cameras: tuple[Source, ...] = ()
    roi: tuple[float, ...] | None = None
    prior: Source | None = None
    options: Mapping[str, Any] = field(default_factory=dict)
    settings: Mapping[str, Any] = field(default_factory=dict)


def row_of(entry: Entry, otherwise: Mapping[str, Any], names: MutableMapping[str, str]) -> Row:
    """The row that an entry is; what it does not say, `otherwise` does. Raises ManifestError.

    names : where each name was given before, which this row's is added to
    """
    try:
        return _row(entry, otherwise, names)
    except PmpnbpError as error:
        raise ManifestError(f"{entry.where}: {error}") from None


def _row(entry: Entry, otherwise: Mapping[str, Any], names: MutableMapping[str, str]) -> Row:
    if entry.fault is not None:
        raise ManifestError(entry.fault)
    given = {name: value for name, value in entry.members.items() if value is not None and value != ""}
    for name in given:
        if name not in MEMBERS:
            raise ManifestError(f"{str(name)[:60]!r} is not known; there are {', '.join(MEMBERS)}")
    said = {**otherwise, **given}
    if ("scan" in said) == ("scans" in said):
        came = "both 'scan' and 'scans' are" if "scan" in said else "neither 'scan' nor 'scans' is"
        raise ManifestError(f"{came} given; expected one of them")
    if "model" not in said:
        raise ManifestError("no 'model' is given; expected a URDF, or a zip that holds one")
    folder = entry.folder
    model = _file(said["model"], folder, "model")
    one = [said["scan"]] if "scan" in said else said["scans"]
    scans = tuple(_file(name, folder, "scan") for name in _listed(one, "scans", "paths"))
    config = said.get("config", {})
    if not isinstance(config, Mapping):
        raise ManifestError(f"'config' is {config!r:.80}; expected settings by name")
    changed(preset("robust"), config)
    cameras = _cameras(said.get("camera"), folder, scans)
    row = Row(
        name=_name(given.get("name"), one[0], entry.where, names),
        model=model,
        scans=scans,
        cameras=cameras,
        roi=None if "roi" not in said else _roi(said["roi"], folder),
        prior=None if "prior" not in said else _source(said["prior"], folder, "prior"),
        options={name: _option(name, said[name]) for name in OPTIONS if name in said},
        settings=dict(config),
    )
    names[row.name.casefold()] = entry.where
    return row


def _option(name: str, value: Any) -> Any:
    if name == "iterations" and str(value) == "0":  # none at all give the start
        return 0
    return checked_option(name, value)


def _listed(value: Any, member: str, of: str) -> Sequence[Any]:
    if not isinstance(value, list | tuple) or not value:
        raise ManifestError(f"'{member}' is {value!r:.80}; expected a list of {of}")
    return value


def _file(name: Any, folder: Path, member: str) -> Path:
    if not isinstance(name, str):
        raise ManifestError(f"'{member}' is {name!r:.80}; expected the path of a file")
    path = folder / name
    try:
        if path.is_file():
            return path
        came = "is a folder; expected a file" if path.is_dir() else "is not there"
    except (OSError, ValueError):  # longer than a path can be, or with a NUL in it
        came = "is no path"
    several = "; several are a list `scans`" if member == "scan" and ";" in name else ""
    raise ManifestError(f"{member} {name[:200]!r} {came}{several}")


def _source(value: Any, folder: Path, member: str) -> Source:
    return value if isinstance(value, Mapping) else _file(value, folder, member)


def _cameras(value: Any, folder: Path, scans: Sequence[Path]) -> tuple[Source, ...]:
    if value is None:
        depth_image = next((scan.name for scan in scans if scan.suffix.lower() == ".png"), None)
        if depth_image is not None:
            raise ManifestError(f"scan {depth_image!r} is a depth image and needs a camera; no 'camera' is given")
        return ()
    several = _listed(value, "camera", "paths") if isinstance(value, list | tuple) else [value]
    if len(several) not in (1, len(scans)):
        raise ManifestError(
            f"{len(several)} cameras are given for {len(scans)} scans; expected one for all or one for each"
        )
    return tuple(_source(one, folder, "camera") for one in several)


def _roi(value: Any, folder: Path) -> tuple[float, ...]:
    """Six numbers, or a file that holds them."""
    if isinstance(value, str):
        path = _file(value, folder, "roi")
        value = read_object(path, "roi file", ManifestError).get("roi")
    numbers = [finite_number(one) for one in value] if isinstance(value, list | tuple) else []
    if len(numbers) != 6 or any(number is None for number in numbers):
        raise ManifestError(f"'roi' is {value!r:.80}; expected six finite numbers x0 y0 z0 x1 y1 z1, metres")
    box = tuple(number for number in numbers if number is not None)
    if any(low >= high for low, high in zip(box[:3], box[3:], strict=True)):
        raise ManifestError(f"'roi' is {list(box)}, which is empty; expected x0 < x1, y0 < y1 and z0 < z1")
    return box


def _name(given: Any, scan: str, where: str, names: Mapping[str, str]) -> str:
    """The name that is given, or else one made of the first scan's path, with a number where it is taken."""
    if given is None:
        made = re.sub(r"[^\w.-]+", "_", str(Path(scan).with_suffix(""))).strip("._") or "row"
        made = made.encode()[-LONGEST_NAME // 2 :].decode(errors="ignore")
        tried, count = made, 1
        while tried.casefold() in names:
            count += 1
            tried = f"{made}_{count}"
        return tried
    if not isinstance(given, str):
        raise ManifestError(f"'name' is {given!r:.60}; expected text")
    fault = name_fault(given)
    if fault is not None:
        raise ManifestError(f"name {given[:60]!r} {fault}")
    if re.search(r"[/\\]", given) or given.startswith(".") or len(given.encode()) > LONGEST_NAME:
        raise ManifestError(
            f"name {given[:60]!r} can be no file's; expected no slashes, no dot at first, {LONGEST_NAME} bytes at most"
        )
    if given.casefold() in names:
        raise ManifestError(f"name {given[:60]!r} is taken by {names[given.casefold()]}")
    return given
