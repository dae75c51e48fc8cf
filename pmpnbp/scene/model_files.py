"""Where are the URDF and the meshes it names? A file's own folder, or a zip unpacked under limits; never outside it."""

from __future__ import annotations

import lzma
import re
import stat
import struct
import tempfile
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from pmpnbp.errors import ModelError
from pmpnbp.files import MEBIBYTE, quoted, read_file, status

# Steps of a path in a zip.
LONGEST_PATH = 64


@dataclass(frozen=True)
class ModelLimits:
    """What a model may cost. Bytes, but for `entries` (files and folders in a zip), `links` and `triangles` (all
    meshes of a model together, each counted as often as it is used)."""

    urdf_bytes: int = 10 * MEBIBYTE
    mesh_bytes: int = 200 * MEBIBYTE
    unpacked_bytes: int = 500 * MEBIBYTE
    entries: int = 5000
    links: int = 1000
    triangles: int = 5_000_000


@dataclass(frozen=True)
class ModelFiles:
    """urdf : the URDF file; root : the folder that nothing it names may lie outside of; from_zip : whether that folder
    is an upload's own, so that packages may be looked for anywhere in it."""

    urdf: Path
    root: Path
    from_zip: bool

    def read_urdf(self, limits: ModelLimits) -> bytes:
        """The URDF's bytes. Raises ModelError where it is too large or cannot be read."""
        return read_file(self.urdf, f"the URDF '{self.urdf.name}'", limits.urdf_bytes, ModelError)

    def read_mesh(self, filename: str, link: str, limits: ModelLimits) -> bytes:
        """The bytes of the mesh a URDF calls `filename` (relative, `file://` or `package://`), used by `link`.

        Raises ModelError where it is missing, too large, or outside the model's folder.
        """
        path = self._find(filename, link)
        return read_file(path, f"mesh '{filename}' of link '{link}'", limits.mesh_bytes, ModelError)

    def _find(self, filename: str, link: str) -> Path:
        root = self.root.resolve()
        outside = False
        for candidate in self._candidates(filename, link):
            try:
                resolved = candidate.resolve()
                if not resolved.is_relative_to(root):
                    outside = True
                elif resolved.is_file():
                    return resolved
            except (OSError, ValueError, RuntimeError):  # a name too long, a NUL in it, a circle of links
                continue
        what = f"mesh '{filename}' of link '{link}'"
        if outside:
            raise ModelError(f"{what} lies outside the model's folder, and nothing outside it is read{self._advice()}")
        if (other := self._in_other_case(filename, link)) is not None:
            raise ModelError(f"{what} is missing; there is '{other}', which differs in upper and lower case only")
        if filename.startswith("package://"):
            raise ModelError(f"{what} is missing: packages are looked for in the model's folder only{self._advice()}")
        raise ModelError(f"{what} is missing")

    def _in_other_case(self, filename: str, link: str) -> str | None:
        """A file below the root that a missing one would be if case did not count, as it does not on other systems."""
        root = self.root.resolve()
        for candidate in self._candidates(filename, link):
            try:
                found = root
                for step in candidate.resolve().relative_to(root).parts:
                    found = next(one for one in sorted(found.iterdir()) if one.name.casefold() == step.casefold())
                if found.is_file() and found.resolve().is_relative_to(root):
                    return found.relative_to(root).as_posix()
            except (OSError, ValueError, RuntimeError, StopIteration):  # as above, outside the root, or no such step
                continue
        return None

    def _advice(self) -> str:
        return "" if self.from_zip else "; zip the URDF together with its meshes"

    def _candidates(self, filename: str, link: str) -> Iterator[Path]:
        """Where the file may be, most likely first; not yet confined to the root."""
        folder = self.urdf.parent
        scheme, separator, rest = filename.partition("://")
        if not separator:
            yield folder / filename
        elif scheme == "file":
            yield folder / rest
            yield folder / rest.lstrip("/")
            yield self.root / rest.lstrip("/")
        elif scheme == "package":
            package, _, inside = rest.partition("/")
            while True:
                yield folder / package / inside
                yield folder / inside
                if folder == self.root or folder == folder.parent:
                    break
                folder = folder.parent
            if self.from_zip:
                for found in sorted(self.root.rglob("*"), key=lambda path: (len(path.parts), path)):
                    if found.name == package and found.is_dir():
                        yield found / inside
        else:
            raise ModelError(
                f"mesh '{filename}' of link '{link}' starts with '{scheme}://', expected a path, file:// or package://"
            )


@contextmanager
def open_model(path: Path, limits: ModelLimits) -> Iterator[ModelFiles]:
    """The files of a model: `path` is a URDF, whose folder is then its root, or a zip with one URDF in it.

    A zip is unpacked to a temporary folder that is gone when the context ends. Raises ModelError.
    """
    name = f"model {quoted(path)}"
    found = status(path, name, ModelError)
    if found is None or not stat.S_ISREG(found.st_mode):
        other = "is a folder" if found and stat.S_ISDIR(found.st_mode) else "is a pipe or a device"
        raise ModelError(f"{name} {other if found else 'is not there'}, expected a URDF file or a zip holding one")
    if path.suffix.lower() == ".xacro":
        raise ModelError(f"model '{path.name}' is a xacro template, expected a URDF: expand it with xacro first")
    try:
        with path.open("rb") as file:
            is_zip = file.read(4) in (b"PK\x03\x04", b"PK\x05\x06")
    except OSError as error:
        raise ModelError(f"{name} cannot be read: {error.strerror}") from None
    if not is_zip:
        if path.suffix.lower() == ".zip":
            raise ModelError(f"model '{path.name}' is not a zip file")
        yield ModelFiles(path, path.parent, from_zip=False)
        return
    with tempfile.TemporaryDirectory(prefix="model-") as folder:
        root = Path(folder)
        _unpack(path, root, limits)
        yield ModelFiles(_find_urdf(path, root), root, from_zip=True)


def _unpack(path: Path, root: Path, limits: ModelLimits) -> None:
    try:
        with zipfile.ZipFile(path) as archive:
            entries = archive.infolist()
            if len(entries) > limits.entries:
                raise ModelError(f"zip '{path.name}' has {len(entries)} entries, expected at most {limits.entries}")
            left = limits.unpacked_bytes
            for entry in entries:
                target = root / _checked_name(entry, path)
                if entry.is_dir() or target == root:
                    target.mkdir(parents=True, exist_ok=True)
                    continue
                target.parent.mkdir(parents=True, exist_ok=True)
                if target.exists():
                    raise ModelError(f"zip '{path.name}' holds '{entry.filename}' twice")
                # Counted while unpacking: the size in the header is the sender's word.
                with archive.open(entry) as source, target.open("xb") as file:
                    while chunk := source.read(min(left + 1, MEBIBYTE)):
                        left -= len(chunk)
                        if left < 0:
                            raise ModelError(
                                f"zip '{path.name}' unpacks to more than {limits.unpacked_bytes / MEBIBYTE:g} MiB"
                            )
                        file.write(chunk)
    except (zipfile.BadZipFile, zlib.error, lzma.LZMAError, struct.error, EOFError, OSError) as error:
        reason = (isinstance(error, OSError) and error.strerror) or error or "it ends too early"
        raise ModelError(f"zip '{path.name}' is damaged: {reason}") from None
    except (NotImplementedError, RuntimeError, ValueError, ArithmeticError, LookupError) as error:
        # zipfile's words for methods it does not know, for passwords, and for headers that make no sense
        raise ModelError(f"zip '{path.name}' cannot be unpacked: {error}") from None


def _checked_name(entry: zipfile.ZipInfo, path: Path) -> PurePosixPath:
    name = entry.filename.replace("\\", "/")
    inside = PurePosixPath(name)
    if inside.is_absolute() or ".." in inside.parts or re.match("[A-Za-z]:", name):
        raise ModelError(f"zip '{path.name}' holds '{entry.filename}', expected relative paths without '..'")
    if len(inside.parts) > LONGEST_PATH:
        raise ModelError(
            f"zip '{path.name}' holds a path of {len(inside.parts)} steps, expected at most {LONGEST_PATH}"
        )
    kind = stat.S_IFMT(entry.external_attr >> 16)
    if kind not in (0, stat.S_IFREG, stat.S_IFDIR):
        raise ModelError(f"zip '{path.name}' holds '{entry.filename}', which is a link or device, expected files")
    if entry.flag_bits & 1:
        raise ModelError(f"zip '{path.name}' is protected by a password")
    return inside


def _find_urdf(path: Path, root: Path) -> Path:
    """The one URDF at the shallowest depth. What macOS adds (`__MACOSX`, `._name`) is not looked at."""
    found = sorted(
        file
        for file in root.rglob("*")
        if file.suffix.lower() == ".urdf" and file.is_file() and not file.name.startswith("._")
        if "__MACOSX" not in file.relative_to(root).parts
    )
    if not found:
        files = sorted(str(file.relative_to(root)) for file in root.rglob("*") if file.is_file())
        raise ModelError(f"zip '{path.name}' holds no .urdf file; it has {_some(files)}")
    depth = min(len(file.parts) for file in found)
    shallowest = [file for file in found if len(file.parts) == depth]
    if len(shallowest) > 1:
        names = [str(file.relative_to(root)) for file in shallowest]
        raise ModelError(f"zip '{path.name}' holds several URDFs, expected one: {_some(names)}")
    return shallowest[0]


def _some(names: list[str]) -> str:
    return ", ".join(names[:8]) + (f" and {len(names) - 8} more" if len(names) > 8 else "") if names else "nothing"
