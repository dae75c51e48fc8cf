"""Every setting has its line of help, can be given as text, and says in one sentence what is wrong with a bad value."""

from __future__ import annotations

from dataclasses import fields

import pytest

from pmpnbp.errors import SettingError
from pmpnbp.settings import METHODS, Settings, changed, check_method, preset, schedule

ENTRIES = {entry.name: entry for entry in fields(Settings)}


def test_a_method_is_one_of_those_there_are() -> None:
    for method in METHODS:
        check_method(method)
    with pytest.raises(SettingError, match="method 'guess' does not exist; there are pmpnbp and particle_filter"):
        check_method("guess")


def one_sentence(error: pytest.ExceptionInfo[SettingError]) -> bool:
    text = str(error.value)
    return "\n" not in text and len(text) > 20


@pytest.mark.parametrize("name", ENTRIES)
def test_every_setting_has_help_and_a_unit(name: str) -> None:
    entry = ENTRIES[name]
    assert len(entry.metadata["help"]) > 10 and "\n" not in entry.metadata["help"]
    assert isinstance(entry.metadata["unit"], str)
    if isinstance(entry.default, (int, float)) and not isinstance(entry.default, bool):
        needs_unit = any(word in name for word in ("position", "tolerance", "rotation", "orientation", "iterations"))
        assert entry.metadata["unit"] or not needs_unit


@pytest.mark.parametrize("name", ENTRIES)
def test_every_setting_reads_its_own_value_as_text(name: str) -> None:
    for value in (ENTRIES[name].default, ENTRIES[name].metadata["paper"]):
        read = getattr(changed(Settings(), {name: str(value)}), name)
        assert read == value and type(read) is type(ENTRIES[name].default)


@pytest.mark.parametrize("name", ENTRIES)
def test_every_setting_refuses_nonsense(name: str) -> None:
    kind = type(ENTRIES[name].default)
    bad = {
        bool: ["perhaps", "2"],
        str: ["nonsense"],
        int: ["1.5", "many", "-1", "nan"],
        float: ["nan", "inf", "-1", "x"],
    }
    for value in bad[kind]:
        with pytest.raises(SettingError, match=name) as error:
            changed(Settings(), {name: value})
        assert repr(value) in str(error.value) or value in str(error.value)
        assert one_sentence(error)


LIMITED = [name for name, entry in ENTRIES.items() if entry.metadata["high"] < float("inf")]


@pytest.mark.parametrize("name", LIMITED)
def test_what_would_take_all_memory_or_cannot_be_reckoned_with_is_refused(name: str) -> None:
    high = ENTRIES[name].metadata["high"]
    assert getattr(changed(Settings(), {name: high}), name) == high
    with pytest.raises(SettingError, match=f"setting '{name}' is {high + 1}; it must be at most {high}"):
        changed(Settings(), {name: high + 1})


def test_an_unknown_name_is_told_what_there_is() -> None:
    with pytest.raises(
        SettingError, match="setting 'particels' does not exist; there are preset, image_width"
    ) as error:
        changed(Settings(), {"particels": 3})
    assert one_sentence(error)
    for name in ENTRIES:
        assert name in str(error.value)


def test_a_truth_value_is_not_a_number() -> None:
    with pytest.raises(SettingError, match=r"joint_draws.*whole number"):
        changed(Settings(), {"joint_draws": True})


def test_whole_numbers_may_be_written_as_others_write_them() -> None:
    assert changed(Settings(), {"joint_draws": "4.0"}).joint_draws == 4
    assert changed(Settings(), {"unary_scale": "1e-1"}).unary_scale == 0.1
    assert changed(Settings(), {"prior_factor": "No"}).prior_factor is False


def test_the_defaults_are_the_preset_robust() -> None:
    assert preset("robust") == Settings()


def test_the_preset_paper_is_the_paper_to_the_letter() -> None:
    paper = preset("paper")
    letter = {
        "pixel_score": "distance",
        "pairwise_form": "limits",
        "belief_product": "pooled",
        "messages_keep_unary": True,
        "effective_share": 0.0,
        "joint_draws": 1,
        "joint_memory": 0.0,
        "neighbour_proposals": 0.0,
        "prior_factor": False,
        "object_estimate": False,
        "neighbour_sum": True,
        "anneal_iterations": 0,
        "search_iterations": 0,
        "refine_iterations": 0,
    }
    assert {name: getattr(paper, name) for name in letter} == letter
    assert paper != Settings()


def test_another_preset_is_refused() -> None:
    with pytest.raises(SettingError, match="preset 'fast' does not exist; there are robust and paper"):
        preset("fast")


def test_a_preset_among_the_changes_comes_first_wherever_it_stands() -> None:
    both = changed(Settings(), {"joint_draws": 3, "preset": "paper"})
    assert both == changed(preset("paper"), {"joint_draws": 3}) and both.joint_draws == 3


def test_the_schedule_goes_from_start_to_end_and_stays_there() -> None:
    settings = Settings()
    over = settings.search_iterations + settings.anneal_iterations
    tolerances = [schedule(settings, iteration).tolerance for iteration in range(1, over + 10)]
    assert tolerances[0] == settings.tolerance_start
    assert tolerances == sorted(tolerances, reverse=True) and len(set(tolerances[: over + 1])) == over + 1
    assert tolerances[over:] == [settings.tolerance_end] * 9
    first, last = schedule(settings, 1), schedule(settings, over + 1)
    assert (first.progress, last.progress) == (0.0, 1.0)
    assert first.diffusion_position == pytest.approx(settings.diffusion_position_start)
    assert last.diffusion_position == settings.diffusion_position_end
    assert last.diffusion_rotation == settings.diffusion_rotation_end
    # the kernel between two parts is never narrower than their diffusion
    assert first.sigma_position >= settings.diffusion_position_start
    assert last.sigma_position == settings.sigma_position


def test_the_preset_paper_has_no_schedule() -> None:
    settings = preset("paper")
    assert schedule(settings, 1) == schedule(settings, 1000)
    plan = schedule(settings, 1)
    assert plan.sigma_position == settings.sigma_position
    assert plan.diffusion_position == settings.diffusion_position_end
