"""How many scans an hour does a batch make, on one worker and on several, and does a killed worker cost a row?

Scans are those of random cabinets, doors and chains from the sample generator, of a few models each before several
cameras, with a region around the object. A first batch of some of them is made on one process; then all of them on
several, of which one is killed in the middle. Each result has to be there once, and be that of its row. Run it:
`python -m benchmarks.batch [--rows 1000] [--alone 200] [--workers 2] [--out out/benchmark_batch]`.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.tables import markdown, progress
from pmpnbp.batch.manifest import read_manifest
from pmpnbp.batch.row import Row
from pmpnbp.batch.run import Made, batch
from pmpnbp.runs.run_log import NAME
from sample_data.scenes import KINDS, write_scene

# Scans of one model.
SCANS = 10
# The first model's number: those before it were tuned on.
FIRST = 1000
# Rows of a batch that are not timed: what is compiled or read for the first time.
UNTIMED = 4


def write_rows(folder: Path, count: int) -> Path:
    """A manifest in `folder` of so many scans, which are rendered where they are not there yet."""
    rows = []
    for number in range(count):
        kind = list(KINDS)[number // SCANS % len(KINDS)]
        seed = FIRST + number // SCANS
        model = folder / f"{kind}_{seed}.urdf"
        urdf, build = KINDS[kind](seed)
        scene = folder / f"{kind}_{seed}_{number % SCANS}"
        if not (scene / "roi.json").is_file():
            model.parent.mkdir(parents=True, exist_ok=True)
            model.write_text(urdf)
            rng = np.random.default_rng([81, number])
            write_scene(scene, build(rng), rng)
            progress(f"scan {number + 1} of {count}")
        named = {name: f"{scene.name}/{name}.json" for name in ("camera", "roi")}
        rows.append(
            {"name": scene.name, "model": model.name, "scan": f"{scene.name}/depth.png", "seed": number, **named}
        )
    manifest = folder / "manifest.jsonl"
    manifest.write_text("".join(json.dumps(row) + "\n" for row in rows))
    return manifest


def timed(rows: Sequence[Row], out: Path, processes: int, kill_at: int | None = None) -> tuple[Made, float]:
    """What is made of the rows, and how many an hour; at the row `kill_at` one of the processes is killed."""
    came: list[float] = []

    def on_row(name: str, error: str | None) -> None:
        came.append(time.perf_counter())
        progress(f"{processes} workers: row {len(came)} of {len(rows)}{'' if error is None else f', {name}: {error}'}")
        if len(came) == kill_at:
            multiprocessing.active_children()[0].kill()

    made = batch(rows, out, title="Benchmark", processes=processes, on_row=on_row)
    if len(came) <= UNTIMED + 1:
        return made, float("nan")
    return made, 3600 * (len(came) - UNTIMED - 1) / (came[-1] - came[UNTIMED])


def check(rows: Sequence[Row], out: Path) -> None:
    """Raise SystemExit where a row is lost or was made twice, or a result is another row's."""
    made = Counter(json.loads(line)["asked"]["name"] for line in (out / NAME).read_text().splitlines()[1:])
    names = {row.name for row in rows}
    lost, doubled = names - set(made), [name for name, count in made.items() if count > 1]
    if lost or doubled or set(made) != names:
        raise SystemExit(f"lost: {sorted(lost)}; made twice: {sorted(doubled)}")
    for row in rows:
        seed = json.loads((out / "results" / f"{row.name}.json").read_text())["seed"]
        if seed != row.options["seed"]:
            raise SystemExit(f"{row.name} has the result of seed {seed}, not {row.options['seed']}")
    if len(list((out / "results").glob("*.json"))) != len(rows):
        raise SystemExit("there are more results than rows")


def main(words: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description="scans an hour in a batch, and a killed worker")
    parser.add_argument("--rows", type=int, default=1000, help="scans (default %(default)s)")
    parser.add_argument("--alone", type=int, default=200, help="of them on one worker (default %(default)s)")
    parser.add_argument("--workers", type=int, default=2, help="processes (default %(default)s)")
    parser.add_argument("--out", type=Path, default=Path("out/benchmark_batch"), help="a folder (default %(default)s)")
    arguments = parser.parse_args(words)
    rows = read_manifest(write_rows(arguments.out / "scans", arguments.rows))
    for name in ("alone", "killed"):
        if (arguments.out / name).exists():
            raise SystemExit(f"'{arguments.out / name}' is there already; a batch that goes on tells no speed")
    _, alone = timed(rows[: arguments.alone], arguments.out / "alone", 1)
    made, together = timed(rows, arguments.out / "killed", arguments.workers, kill_at=arguments.rows // 2)
    check(rows, arguments.out / "killed")
    table = [
        ["1", f"{min(arguments.alone, arguments.rows)}", f"{alone:.0f}", ""],
        [
            f"{arguments.workers}, one killed in the middle",
            f"{len(rows)}",
            f"{together:.0f}",
            f"{together / alone:.2f}",
        ],
    ]
    print(markdown(["workers", "scans", "scans an hour", "as a multiple"], table))
    told = ", ".join(f"{count} {verdict}" for verdict, count in made.counts.items())
    print(f"\nNo row lost, none made twice: {told}.")


if __name__ == "__main__":
    main()
