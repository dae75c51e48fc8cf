"""A recording: one SQLite file with what an inference was given and every iteration it made.

`RecordingWriter` writes it beside the inference, `Recording` reads it, also while it is being written and after the
writer was killed. `schema` says what is in the file.
"""

from pmpnbp.recording.inputs import Inputs
from pmpnbp.recording.reader import Recording
from pmpnbp.recording.writer import RecordingWriter, fold_log

__all__ = ["Inputs", "Recording", "RecordingWriter", "fold_log"]
