"""Models: URDFs, alone or in a zip with their meshes."""

from __future__ import annotations

from pydantic import BaseModel, Field

from app.routes.entries import Stored, add_deletion, entry_routes, form


class ModelJoint(BaseModel):
    """A joint of the URDF."""

    name: str = Field(description="as the URDF has it")
    type: str = Field(description="fixed, revolute, continuous, prismatic, planar or floating")
    parent: str = Field(description="link above")
    child: str = Field(description="link below")
    lower: float | None = Field(
        description="smallest position, metres (prismatic, planar, floating) or radians; null where fixed"
    )
    upper: float | None = Field(description="largest position, metres or radians; null where fixed")
    mimic: str | None = Field(description="the joint that it follows, or null")


class ModelPart(BaseModel):
    """Links that are fixed to each other and move as one: what the inference estimates."""

    name: str = Field(description="that of its first link with geometry")
    links: list[str] = Field(description="from its own root down")


class Model(Stored):
    """A model, ready for sessions."""

    name: str = Field(description="as the URDF says, else the file's", examples=["cabinet"])
    links: list[str] = Field(description="from the root down", examples=[["frame", "drawer1"]])
    joints: list[ModelJoint] = Field(description="from the root down, fixed ones too")
    parts: list[ModelPart] = Field(description="nodes of the Markov random field")


router = entry_routes(
    "models",
    Model,
    "A URDF, or a zip holding one with the meshes it names. Metres and radians throughout.",
    form("a URDF, or a zip with one URDF and its meshes"),
)
add_deletion(router, "models")
