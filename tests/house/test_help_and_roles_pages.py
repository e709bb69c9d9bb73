"""Help links and password limits of the pages match the documents and the server."""

from __future__ import annotations

import re

from gss.api.present.help_page import documents, help_page, slug
from gss.operations.accounts.passwords import LONGEST, SHORTEST
from gss.operations.contacts.handover import MAX_NOTE_LENGTH


def test_every_page_has_a_chapter_that_exists(root):
    """Every help link of a page points to an existing section."""
    source = (root / "web" / "src" / "lib" / "help.ts").read_text("utf-8")
    chapters = re.findall(r"'([\w-]+)#([\w-]+)'", source)
    known = documents(root / "docs")
    assert len(chapters) >= 9
    for name, section in chapters:
        heads = re.findall(r"^#+ (.+)$", known[name].path.read_text("utf-8"), re.MULTILINE)
        assert section in [slug(h) for h in heads], f"{name}#{section}"


def test_every_link_between_documents_leads_somewhere(root):
    """Every link of a rendered document points to another document, an existing picture or an external site."""
    known = documents(root / "docs")
    for document in known.values():
        page = help_page(document.path.read_text("utf-8"), document, known)
        for picture in re.findall(r'src="/help/pictures/([^"]+)"', page):
            assert (root / "docs" / "pictures" / picture).is_file(), f"{document.name}: {picture}"
        assert "<script>" not in page


def test_the_pages_ask_for_passwords_as_long_as_the_server_does(root):
    """The page and the server have the same limits for the length of a password."""
    source = (root / "web" / "src" / "lib" / "password.ts").read_text("utf-8")
    assert f"MIN_LENGTH = {SHORTEST};" in source
    assert f"MAX_LENGTH = {LONGEST};" in source


def test_the_page_accepts_hand_over_notes_as_long_as_the_server_does(root):
    """The page and the server have the same limit for the length of a hand-over note."""
    source = (root / "web" / "src" / "pages" / "contacts" / "HandoverSection.svelte").read_text("utf-8")
    assert f"MAX_NOTE_LENGTH = {MAX_NOTE_LENGTH};" in source
