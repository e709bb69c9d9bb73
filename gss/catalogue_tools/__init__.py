"""Catalogue tools: from a published star catalogue to a verified bank image. No side effects."""
