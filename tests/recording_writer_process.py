"""Run as a program by test_recording: writes iterations as fast as it can until it is killed.

Arguments: the recording to write, one to take inputs and iterations from, and a folder for the model.
"""

from __future__ import annotations

import itertools
import sys
from dataclasses import replace
from pathlib import Path

from pmpnbp.recording import Recording, RecordingWriter


def write_for_ever(target: Path, source: Path, folder: Path) -> None:
    """Write the source's iterations over and over, numbered on, and say so once the first are on their way."""
    with Recording(source) as recording:
        known = [(recording.report(k), recording.state(k)) for k in recording.iterations()]
        inputs = recording.restored_inputs(folder)
        model = recording.problem().mrf.model
    with RecordingWriter(target, inputs, model) as writer:
        for number in itertools.count():
            report, state = known[number % len(known)]
            writer.write(replace(report, iteration=number), replace(state, iteration=number))
            if number == 0:
                print("writing", flush=True)


if __name__ == "__main__":
    write_for_ever(*(Path(argument) for argument in sys.argv[1:]))
