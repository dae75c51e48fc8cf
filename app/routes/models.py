"""Models: URDFs, alone or in a zip with their meshes."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter, Request, Response
from pydantic import BaseModel, Field

from app.problems import responses
from app.routes.entries import IF_NONE_MATCH, Stored, created, form, unchanged_or
from app.store.store import Store
from app.uploads.uploads import Uploads

router = APIRouter(prefix="/api/v1", tags=["models"])


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


@router.post(
    "/models",
    status_code=201,
    response_model=Model,
    operation_id="create_model",
    summary="Upload a model",
    description="A URDF, or a zip holding one with the meshes it names. Metres and radians throughout.",
    responses=created(Model) | responses(408, 409, 413, 415, 507),
    openapi_extra=form("a URDF, or a zip with one URDF and its meshes"),
)
async def create_model(request: Request, response: Response) -> Any:
    """Take in the form's part `file`."""
    uploads: Uploads = request.app.state.uploads
    return await uploads.take_in(request, response, "models")


@router.get(
    "/models",
    response_model=list[Model],
    operation_id="list_models",
    summary="All models",
    description="Oldest first.",
)
def list_models(request: Request) -> Any:
    """Every model's document."""
    store: Store = request.app.state.store
    return store.models()


@router.get(
    "/models/{model_id}",
    response_model=Model,
    operation_id="get_model",
    summary="One model",
    description="Never changes, as its ETag says: ask with If-None-Match.",
    responses=IF_NONE_MATCH | responses(404),
)
def get_model(model_id: str, request: Request, response: Response) -> Any:
    """A model's document, or 304."""
    store: Store = request.app.state.store
    return unchanged_or(request, response, store.model(model_id))


@router.delete(
    "/models/{model_id}",
    status_code=204,
    operation_id="delete_model",
    summary="Delete a model",
    description="Only where no session uses it.",
    responses=responses(404, status_409="A session uses it; the detail names it."),
)
def delete_model(model_id: str, request: Request) -> Response:
    """Forget a model."""
    store: Store = request.app.state.store
    store.delete_model(model_id)
    return Response(status_code=204)
