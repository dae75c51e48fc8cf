"""What the `--help` of each command ends with: a call that can be typed as it stands, in whatever folder one is."""

from __future__ import annotations

import os
from pathlib import Path

_EXAMPLES = {
    "estimate": """\
example, a cabinet of which nothing is known but a box around it:
  pmpnbp estimate {cabinet}/cabinet.urdf {cabinet}/open/depth.png \\
      --camera {cabinet}/open/camera.json --roi=-0.08,-0.19,-0.1,0.89,0.7,0.85 \\
      --out result.json --recording open.sqlite
""",
    "serve": """\
example, with the sample session open, on another port and in a folder of its own:
  pmpnbp serve --demo --port 8081 --data-dir sessions
""",
    "view": """\
example, what `pmpnbp estimate --recording open.sqlite` wrote:
  pmpnbp view open.sqlite
""",
    "settings": """\
example, and how one of them is set:
  pmpnbp settings
  pmpnbp estimate {cabinet}/cabinet.urdf {cabinet}/open/depth.png \\
      --camera {cabinet}/open/camera.json --config effective_share=0.2
""",
    "benchmark": """\
example:
  pmpnbp benchmark --out speeds.json
""",
    "reproduce": """\
example, figures, tables and report in out/occlusion, two runs at a time:
  pmpnbp reproduce occlusion --runs 10 --processes 2
""",
    "calibrate": """\
example, the report's first sentence answers:
  pmpnbp calibrate {cabinet}/cabinet.urdf --runs 200 --processes 2 --out calibrated
""",
    "batch": """\
example, a folder of scenes, and a list of scans that two processes look through:
  pmpnbp batch {cabinet} --out found
  pmpnbp batch scans.csv --processes 2
""",
    "completion": """\
example, from the next shell on, for bash, zsh and fish:
  pmpnbp completion bash > ~/.local/share/bash-completion/completions/pmpnbp
  pmpnbp completion zsh > ~/.zfunc/_pmpnbp    # a folder that is in $fpath
  pmpnbp completion fish > ~/.config/fish/completions/pmpnbp.fish
""",
}


def example(command: str) -> str | None:
    """The command's example, its files as they are called from the working folder; None where it has none here."""
    text = _EXAMPLES.get(command)
    cabinet = os.path.relpath(Path(__file__).resolve().parents[1] / "sample_data" / "cabinet")
    return None if text is None else text.format(cabinet=cabinet)
