"""Composition root, the only place where services meet: one file per room of operations, with its record and the function that
creates it; ``build`` connects the rooms."""
