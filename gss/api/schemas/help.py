"""Help pages."""

from __future__ import annotations

from gss.api.schemas.base import Out


class HelpPageOut(Out):
    """Help page at ``/help/NAME``. ``group``: its part of the table of contents."""

    name: str
    title: str
    group: str
