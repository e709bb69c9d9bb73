"""Serve the documents from the console's origin: guides by role, reference and design decisions."""

from __future__ import annotations

import re
from pathlib import Path

from fastapi import APIRouter
from fastapi.responses import FileResponse, HTMLResponse

from gss.api.api_router import api_router
from gss.api.present.help_page import CONTENTS, GROUPS, PICTURES, documents, help_page, not_found_page
from gss.api.schemas.help import HelpPageOut
from gss.domain.errors import NotFound

_PACKAGE = Path(__file__).parents[2]
DOCS = _PACKAGE / "docs" if (_PACKAGE / "docs").is_dir() else _PACKAGE.parent / "docs"
"""The documents are inside the package in the wheel, and beside the package in a checkout."""
DEFAULT_TEXT = "# Help\n\nChoose a page from the list on the left."

router = APIRouter(prefix="/help", include_in_schema=False)
listing = api_router("help", "/help")


@listing.get("")
def list_pages() -> list[HelpPageOut]:
    """Help pages, in the order of the table of contents."""
    groups = dict(GROUPS)
    return [HelpPageOut(name=d.name, title=d.title, group=groups[d.group]) for d in documents(DOCS).values()]


@router.get("")
@router.get("/")
def read_contents() -> HTMLResponse:
    """Contents page."""
    documents_by_name = documents(DOCS)
    first = documents_by_name.get(CONTENTS)
    return HTMLResponse(help_page(first.path.read_text("utf-8") if first else DEFAULT_TEXT, first, documents_by_name))


@router.get(f"/{PICTURES}/{{name}}")
def read_picture(name: str) -> FileResponse:
    """Picture of a document."""
    path = DOCS / PICTURES / name
    if not re.fullmatch(r"[\w-]+\.(png|svg|jpg)", name) or not path.is_file():
        raise NotFound("no such image", got=name)
    return FileResponse(path)


@router.get("/{name}")
def read_document(name: str) -> HTMLResponse:
    """Document by name."""
    documents_by_name = documents(DOCS)
    if name not in documents_by_name:
        return HTMLResponse(not_found_page(name, documents_by_name), 404)
    return HTMLResponse(
        help_page(documents_by_name[name].path.read_text("utf-8"), documents_by_name[name], documents_by_name)
    )
