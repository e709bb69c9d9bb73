"""Convert the Markdown documents to HTML pages in the console's style, without scripts from documents."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from itertools import pairwise
from pathlib import Path, PurePosixPath

from markdown_it import MarkdownIt
from markdown_it.token import Token

PICTURES = "pictures"
CONTENTS = "README"
GROUPS = (("guide", "Guide"), (".", "Reference"), ("decisions", "Design decisions"))
FIRST = ("tutorial", "operator", "catalogue-manager", "engineer", "admin")
_RENDERER = MarkdownIt("default", {"html": False, "linkify": False})


@dataclass(frozen=True)
class Document:
    """A document that is served under ``name``."""

    name: str
    title: str
    group: str
    path: Path


def documents(folder: Path) -> Mapping[str, Document]:
    """Return the documents of the folder by name, in the order of the table of contents."""
    documents_by_name: dict[str, Document] = {}
    for group, _ in GROUPS:
        paths = sorted((folder / group).glob("*.md"), key=lambda p: (_rank(p.stem), p.stem))
        documents_by_name.update(
            {p.stem: Document(p.stem, _title(p), group, p) for p in paths if p.stem not in documents_by_name}
        )
    return documents_by_name


def help_page(text: str, shown: Document | None, documents_by_name: Mapping[str, Document]) -> str:
    """Return the HTML page of a document's text, with the table of contents beside it."""
    tokens = _RENDERER.parse(text)
    heads = _anchor(tokens)
    _relink(tokens, documents_by_name)
    body = _RENDERER.renderer.render(tokens, _RENDERER.options, {})
    return _page(shown.title if shown else "Help", body, _contents(documents_by_name, shown, heads))


def single_page(title: str, text: str) -> str:
    """Return the page of one Markdown text that is not part of the documents, with its headings beside it."""
    tokens = _RENDERER.parse(text)
    heads = _anchor(tokens)
    _relink(tokens, {})
    links = "".join(f"<li><a href='#{anchor}'>{escape(heading)}</a></li>" for anchor, heading in heads)
    return _page(title, _RENDERER.renderer.render(tokens, _RENDERER.options, {}), f"<ul>{links}</ul>" if links else "")


def not_found_page(name: str, documents_by_name: Mapping[str, Document]) -> str:
    """Return the page for an unknown document name."""
    body = f"<h1>Page not found</h1><p>There is no page “{escape(name)}”. Choose one from the list on the left.</p>"
    return _page("Page not found", body, _contents(documents_by_name, None, ()))


def slug(text: str) -> str:
    """Return the anchor of a heading, in the format that code hosts use."""
    return re.sub(r"[^\w\- ]", "", text.strip().lower()).replace(" ", "-")


def _rank(stem: str) -> int:
    return FIRST.index(stem) if stem in FIRST else len(FIRST)


def _title(path: Path) -> str:
    with path.open(encoding="utf-8") as lines:
        line = next((line for line in lines if line.startswith("# ")), path.stem)
    return line.removeprefix("# ").strip().replace("`", "")


def _anchor(tokens: Sequence[Token]) -> list[tuple[str, str]]:
    """Set the id of every heading. Return (id, text) of the second-level headings."""
    heads, used = [], set[str]()
    for opening, inline in pairwise(tokens):
        if opening.type != "heading_open":
            continue
        title = "".join(part.content for part in inline.children or () if part.type in ("text", "code_inline"))
        anchor = name = slug(title)
        number = 1
        while anchor in used:
            anchor, number = f"{name}-{number}", number + 1
        used.add(anchor)
        opening.attrSet("id", anchor)
        if opening.tag == "h2":
            heads.append((anchor, title))
    return heads


def _relink(tokens: Iterable[Token], documents_by_name: Mapping[str, Document]) -> None:
    """Rewrite links between documents and to pictures; links to other repository files lead to the help contents."""
    for token in tokens:
        for part in token.children or ():
            if part.type == "link_open":
                part.attrSet("href", _target(str(part.attrGet("href") or ""), documents_by_name))
                if str(part.attrGet("href")).startswith("http"):
                    part.attrSet("rel", "noreferrer")
            elif part.type == "image":
                part.attrSet("src", f"/help/{PICTURES}/{PurePosixPath(str(part.attrGet('src') or '')).name}")
                part.attrSet("loading", "lazy")


def _target(href: str, documents_by_name: Mapping[str, Document]) -> str:
    if re.match(r"https?:|mailto:|#", href):
        return href
    path, _, fragment = href.partition("#")
    name = PurePosixPath(path).stem
    if name in documents_by_name and name != CONTENTS:
        return f"/help/{name}{'#' + fragment if fragment else ''}"
    return "/help"


def _contents(
    documents_by_name: Mapping[str, Document], shown: Document | None, heads: Sequence[tuple[str, str]]
) -> str:
    parts = []
    for group, title in GROUPS:
        rows = [
            _entry(d, d is shown, heads) for d in documents_by_name.values() if d.group == group and d.name != CONTENTS
        ]
        if rows:
            parts.append(f"<h2>{title}</h2><ul>{''.join(rows)}</ul>")
    return "".join(parts)


def _entry(document: Document, current: bool, heads: Sequence[tuple[str, str]]) -> str:
    link = f"<a href='/help/{document.name}'{' aria-current=page' if current else ''}>{escape(document.title)}</a>"
    inner = "".join(f"<li><a href='#{anchor}'>{escape(title)}</a></li>" for anchor, title in heads) if current else ""
    return f"<li>{link}{f'<ul>{inner}</ul>' if inner else ''}</li>"


def _page(title: str, body: str, contents: str) -> str:
    return (
        "<!doctype html><html lang=en><head><meta charset=utf-8>"
        "<meta name=viewport content='width=device-width, initial-scale=1'>"
        f"<title>{escape(title)} · GSS help</title><link rel=icon href=/icon.svg>"
        "<link rel=stylesheet href=/tokens.css><link rel=stylesheet href=/help.css><script src=/help.js></script></head>"
        "<body><header><b>GSS help</b><a href='/help'>Contents</a><a href='/live'>Console</a></header>"
        f"<div class=both><nav aria-label=Chapters>{contents}</nav><main>{body}</main></div></body></html>"
    )
