"""``gss check device``: the interface document, clause by clause."""
