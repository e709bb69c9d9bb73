"""Documents are served as pages of the same origin."""

from __future__ import annotations

import pytest
from fastapi import FastAPI
from fastapi.testclient import TestClient

from gss.api import errors
from gss.api.present.help_page import Document, help_page
from gss.api.routers import help as help_router


@pytest.fixture(scope="module")
def help_client():
    """Client of an application that serves only the documents."""
    app = FastAPI()
    errors.install(app)
    app.include_router(help_router.router)
    with TestClient(app) as client:
        yield client


def test_contents_chapters_and_pictures_are_served(help_client):
    """The contents page links to chapters. The headings of a chapter are anchors, and GSS serves its pictures."""
    contents = help_client.get("/help")
    assert contents.status_code == 200
    assert "/help/operator" in contents.text
    chapter = help_client.get("/help/operator")
    assert 'id="alarms"' in chapter.text
    assert 'src="/help/pictures/' in chapter.text
    assert help_client.get("/help/pictures/live.png").headers["content-type"] == "image/png"


def test_the_help_pages_are_listed_for_the_palette(clients):
    """The list has name, title and group of each page, and each name is the address of a page."""
    pages = clients["viewer"].get("/api/help").json()
    assert {"name": "operator", "title": "Operator: a pass", "group": "Guide"} in pages
    assert {page["group"] for page in pages} == {"Guide", "Reference", "Design decisions"}
    assert {clients["viewer"].get(f"/help/{page['name']}").status_code for page in pages[:5]} == {200}


@pytest.mark.parametrize("name", ["nothing", "..%2Fpyproject", "README.md", "%00", "pictures"])
def test_an_unknown_chapter_is_a_page_with_the_contents(help_client, name):
    """The server reads only known names as files and answers 404 otherwise."""
    answer = help_client.get(f"/help/{name}")
    assert answer.status_code == 404
    assert "Operator" in answer.text or "no such" in answer.text or "Not Found" in answer.text


@pytest.mark.parametrize("name", ["..%2F..%2Fpyproject.toml", "live.md", ".png", "x%00.png"])
def test_only_pictures_are_served_as_pictures(help_client, name):
    """The server does not return files outside the folder or of another type."""
    assert help_client.get(f"/help/pictures/{name}").status_code == 404


def test_a_document_runs_nothing(tmp_path):
    """Markup in a document is shown as text, and a script address does not become a link."""
    text = "# T\n\n<script>alert(1)</script> <b onclick=x>hi</b>\n\n[a](javascript:alert(1)) ![p](../x/y.png) [c](other.md#part)"
    documents = {"other": Document("other", "Other", ".", tmp_path / "other.md")}
    page = help_page(text, None, documents)
    assert "<script>" not in page.split("</head>")[1]
    assert "&lt;script&gt;" in page
    assert "javascript:" not in page.replace("[a](javascript:alert(1))", "")
    assert 'src="/help/pictures/y.png"' in page
    assert 'href="/help/other#part"' in page


def test_two_equal_headings_have_different_anchors():
    """The anchor of the second heading has a number, as on code hosts."""
    page = help_page("# A\n\n## Part `x`\n\n## Part `x`\n", None, {})
    assert 'id="part-x"' in page
    assert 'id="part-x-1"' in page
