"""Does an experiment go on where it was interrupted?"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from benchmarks.reproduce.experiment import Experiment, Options, make
from pmpnbp.runs.run_log import RunLog
from tests.reproduce import example_runs

NUMBERS = [{"number": number} for number in range(4)]


def test_an_experiment_goes_on_where_it_was_interrupted(tmp_path: Path) -> None:
    written: list[RunLog] = []
    options = Options(tmp_path)

    def stage(_: Options, run_log: RunLog) -> list[dict[str, Any]]:
        return [{**one, "folder": str(tmp_path)} for one in NUMBERS]

    def interrupted(_: Options, run_log: RunLog) -> list[dict[str, Any]]:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        make("push", Experiment(example_runs.slow, (stage, interrupted), lambda _, run_log: None), options)
    make("push", Experiment(example_runs.always_killed, (stage,), lambda _, run_log: written.append(run_log)), options)
    assert [written[0].get(one) is not None for one in stage(options, written[0])] == [True] * 4
