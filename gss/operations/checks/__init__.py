"""Implementation of ``gss check device``: conformance to the interface document, clause by clause."""
