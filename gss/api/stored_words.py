"""Parse stored request bodies again, to restart jobs that a crash interrupted."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from typing import Any

from pydantic import ValidationError

from gss.api.catalogue_words import request_of
from gss.api.routers.design import question_of
from gss.api.schemas.catalogues import CatalogueIn
from gss.api.schemas.design import DesignIn
from gss.catalogue_tools.request import BuildRequest
from gss.domain.errors import BadInput
from gss.operations.catalogues.design import Question
from gss.wiring import Services

OLDER = "it was asked for in words of another version"


def install(services: Services) -> None:
    """Register the parsers of stored requests with the services."""
    services.catalogues.words = _build
    services.design.words = _question


def _build(asked: Mapping[str, Any], user: str, at: datetime) -> BuildRequest:
    try:
        return request_of(CatalogueIn.model_validate(dict(asked)), user, at)
    except ValidationError as error:
        raise BadInput(OLDER, got=str(error.errors()[0]["msg"]), hint="build it again on the Catalogues page") from None


def _question(asked: Mapping[str, Any]) -> Question:
    try:
        return question_of(DesignIn.model_validate(dict(asked)))
    except ValidationError as error:
        raise BadInput(OLDER, got=str(error.errors()[0]["msg"]), hint="ask again on the Design page") from None
