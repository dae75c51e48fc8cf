"""What can be set about the server? Every entry: name, default, unit, one line of help.

An entry is a field of `ServerConfig`. The options of `pmpnbp serve` and the environment's PMPNBP_<NAME> are derived
from these entries; a command-line option goes before the environment, which goes before the default.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from pmpnbp.errors import SettingError

PREFIX = "PMPNBP_"
LOOPBACK = ("127.0.0.1", "::1", "localhost")

_MIB = 1 << 20
_GIB = 1 << 30


def default_data_dir(environment: Mapping[str, str] = os.environ) -> Path:
    """Where user data goes by the XDG base directory specification."""
    home = environment.get("XDG_DATA_HOME", "")
    return (Path(home) if home.startswith("/") else Path.home() / ".local" / "share") / "pmpnbp"


def _entry(default: Any, unit: str, help_text: str, low: float = -math.inf, high: float = math.inf) -> Any:
    metadata = {"unit": unit, "help": help_text, "low": low, "high": high, "default": default}
    return field(default=default, metadata=metadata)


@dataclass(frozen=True)
class ServerConfig:
    """All there is to set about a server; checked on construction, raises SettingError."""

    host: str = _entry("127.0.0.1", "", "address to listen on; one that is not loopback needs a token")
    port: int = _entry(8080, "", "port to listen on; 0 takes a free one", low=0, high=65535)
    data_dir: Path = field(
        default_factory=default_data_dir,
        metadata={"unit": "", "help": "folder for models, scans, sessions and recordings", "default": "per user"},
    )
    token: str | None = _entry(None, "", "secret that programs and the page's link must carry")
    demo: bool = _entry(False, "", "open the sample session")
    max_running: int = _entry(2, "sessions", "that iterate at once; others wait", low=1)
    max_sessions: int = _entry(100, "sessions", "that are kept", low=1)
    max_upload_bytes: int = _entry(256 * _MIB, "bytes", "of one upload", low=1024)
    max_disk_bytes: int = _entry(20 * _GIB, "bytes", "that the data directory may take", low=1024)
    max_memory_bytes: int = _entry(
        0, "bytes", "of memory that the server may take with its sessions; 0: what machine and container have", low=0
    )
    parse_seconds: float = _entry(15.0, "seconds", "that reading an upload may take", low=0.1)
    # The readers of models take 800 MiB of addresses for their libraries alone.
    parse_bytes: int = _entry(2 * _GIB, "bytes", "of memory that reading an upload may take", low=_GIB)
    requests_per_second: float = _entry(1000.0, "1/s", "requests of one client, on average", low=0.1)
    max_views: int = _entry(60, "3D views", "open at once", low=1)
    max_views_full_rate: int = _entry(
        20,
        "3D views",
        "that are drawn 12 times a second, while a session runs 24 times all together; those opened later then every "
        "2 seconds",
        low=1,
    )
    max_clients: int = _entry(400, "clients", "connected at once: requests, event streams and 3D views", low=1)
    max_clients_each: int = _entry(300, "clients", "of these, of one address", low=1)
    max_uploads: int = _entry(32, "uploads", "that come in at once; all further ones are refused", low=1)
    max_uploads_each: int = _entry(8, "uploads", "of these, of one address", low=1)
    max_connections_each: int = _entry(512, "connections", "of one address, idle ones among them", low=1)
    header_seconds: float = _entry(10.0, "seconds", "until a request's header must be whole", low=0.1)
    # A body that goes on may pause for six times as long.
    body_seconds: float = _entry(10.0, "seconds", "that a request's body may be behind 1 KiB/s", low=0.1)

    def __post_init__(self) -> None:
        for entry in fields(self):
            value, low, high = getattr(self, entry.name), entry.metadata.get("low"), entry.metadata.get("high")
            if low is not None and high is not None and isinstance(value, int | float) and not low <= value <= high:
                limit = f"at least {low}" if high == math.inf else f"from {low} to {high}"
                raise SettingError(f"server setting '{entry.name}' is {value!r}; it must be {limit}")
        if not self.host:
            raise SettingError("server setting 'host' is empty; expected an address such as 127.0.0.1")
        if self.token is not None and not (self.token.isascii() and self.token.isprintable() and self.token.strip()):
            raise SettingError("server setting 'token' is empty or has characters that a header cannot carry")

    @property
    def loopback(self) -> bool:
        """Whether only this machine can reach the server."""
        return self.host in LOOPBACK


def environment_name(name: str) -> str:
    """`max_running` as PMPNBP_MAX_RUNNING."""
    return PREFIX + name.upper()


def config_from(given: Mapping[str, Any], environment: Mapping[str, str] = os.environ) -> ServerConfig:
    """The configuration from `given` (None: not given), then the environment, then the defaults.

    Raises SettingError for a value of the wrong kind, naming the variable.
    """
    values: dict[str, Any] = {}
    for entry in fields(ServerConfig):
        value = given.get(entry.name)
        text = environment.get(environment_name(entry.name), "")
        if value is not None:
            values[entry.name] = value
        elif text:
            values[entry.name] = convert(entry.name, text, environment_name(entry.name))
    return ServerConfig(**values)


def convert(name: str, text: str, source: str) -> Any:
    """`text` as the entry `name` has it; `source` is what an error names."""
    kind = {entry.name: str(entry.type) for entry in fields(ServerConfig)}[name]
    if kind == "bool":
        if text.lower() in ("true", "1", "yes", "on", "false", "0", "no", "off"):
            return text.lower() in ("true", "1", "yes", "on")
        raise SettingError(f"{source} is {text!r}; it must be true or false")
    if kind == "Path":
        return Path(text).expanduser().absolute()  # processes that read uploads work in another folder
    if kind in ("int", "float"):
        try:
            number = int(text) if kind == "int" else float(text)
            if math.isfinite(number):
                return number
        except ValueError:
            pass
        expected = "a whole number" if kind == "int" else "a finite number"
        raise SettingError(f"{source} is {text!r}; it must be {expected}")
    return text
