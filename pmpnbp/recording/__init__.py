"""A recording: one SQLite file with what an inference was given and every iteration it made.

`RecordingWriter` writes it beside the inference, `Recording` reads it, also while it is being written and after the
writer was killed, and `make_whole` lets another writer go on with it. `IterationArchive` is all of these for one
inference. `schema` says what is in the file.
"""

from pmpnbp.recording.archive import IterationArchive
from pmpnbp.recording.changes import Change
from pmpnbp.recording.inputs import Inputs, prepare
from pmpnbp.recording.reader import Recording
from pmpnbp.recording.reopening import make_whole
from pmpnbp.recording.writer import RecordingWriter, fold_log

__all__ = ["Change", "Inputs", "IterationArchive", "Recording", "RecordingWriter", "fold_log", "make_whole", "prepare"]
