"""What can be set about an estimate? Every entry of `pmpnbp.settings`, as `config` of a session takes it."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import fields
from typing import Any, cast

from fastapi import APIRouter
from pydantic import BaseModel, Field

from pmpnbp.settings import SessionOptions, Settings

router = APIRouter(prefix="/api/v1", tags=["settings"])


class Setting(BaseModel):
    """One entry."""

    name: str = Field(description="its name in a session's `config`", examples=["tolerance_end"])
    kind: str = Field(description='"boolean", "integer", "number" or "string"', examples=["number"])
    default: bool | int | float | str = Field(description="value of the preset `robust`", examples=[0.012])
    paper: bool | int | float | str = Field(description="value of the preset `paper`", examples=[0.012])
    unit: str = Field(description="its unit; empty for a plain number or a choice", examples=["m"])
    help: str = Field(description="one line", examples=["distance at which a pixel stops to be explained, annealed"])
    low: float | None = Field(description="smallest value allowed; null: no limit, or no number", examples=[0.0001])
    high: float | None = Field(description="largest value allowed; null: no limit, or no number", examples=[1280])
    choices: list[str] = Field(description="values allowed; empty: no list", examples=[[]])


class AllSettings(BaseModel):
    """Every setting and preset, and the options that are numbers or words."""

    presets: list[str] = Field(description="values that `preset` in a `config` takes", examples=[["robust", "paper"]])
    settings: list[Setting] = Field(description="in the order of the stages they belong to")
    options: list[Setting] = Field(description="what a session is created with and keeps: its members, not its config")


_KINDS: dict[type, str] = {bool: "boolean", int: "integer", float: "number", str: "string"}


@router.get("/settings", summary="Every setting")
def list_settings() -> AllSettings:
    """Name, default, unit and one line of help of everything that a session's `config` takes; lengths are in metres,
    angles in radians."""
    options = [_described(entry) for entry in fields(SessionOptions) if entry.default is not None]
    return AllSettings(presets=["robust", "paper"], settings=[*map(_described, fields(Settings))], options=options)


def _described(entry: dataclasses.Field[Any]) -> Setting:
    about, default = entry.metadata, cast(bool | int | float | str, entry.default)
    return Setting(
        name=entry.name,
        kind=_KINDS[type(default)],
        default=default,
        paper=about["paper"],
        unit=about["unit"],
        help=about["help"],
        low=about["low"] if math.isfinite(about["low"]) else None,
        high=about["high"] if math.isfinite(about["high"]) else None,
        choices=list(about["choices"]),
    )
