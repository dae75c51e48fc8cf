"""What does the sample session look at? The cabinet of `sample_data/`, an open drawer seen from the front."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

from app.server_config import ServerConfig
from app.store.store import Store
from app.uploads.parsers import Parsers

NAME = "Sample: a cabinet with an open drawer"


def sample_document(store: Store, config: ServerConfig) -> dict[str, Any] | None:
    """What `Sessions.create` takes for it, with model and scan put into the store; None where there is no sample data.

    The sample data is not installed: it is looked for beside the package and in the working folder.
    """
    places = (Path(__file__).resolve().parents[2] / "sample_data", Path.cwd() / "sample_data")
    folder = next((place / "cabinet" for place in places if (place / "cabinet" / "open").is_dir()), None)
    if folder is None:
        return None
    scene = folder / "open"
    parsers = Parsers(config.parse_bytes, config.parse_seconds)
    try:
        with store.staging() as staging:
            model, depth, camera, out = (
                staging.folder / name for name in ("cabinet.urdf", "depth.png", "camera.json", "scan.npz")
            )
            for source, target in ((folder / model.name, model), (scene / depth.name, depth)):
                shutil.copyfile(source, target)
            shutil.copyfile(scene / camera.name, camera)
            model_id = store.add_model(model, model.name, parsers.parse("models", model, out, None))["id"]
            summary = parsers.parse("scans", depth, out, camera)
            scan_id = store.add_scan(out, depth.name, summary)["id"]
    finally:
        parsers.close()
    return {
        "name": NAME,
        "model_id": model_id,
        "scan_ids": [scan_id],
        "roi": json.loads((scene / "region.json").read_text(encoding="utf-8"))["region"],
        "truth": _truth(scene),
    }


def _truth(scene: Path) -> dict[str, Any]:
    members = json.loads((scene / "truth.json").read_text(encoding="utf-8"))
    return {name: members[name] for name in ("links", "joints")}
