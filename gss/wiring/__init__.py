"""Composition root, the only package that connects services. There is one file per room of operations, which contains a record
of the room's services and the function that creates them. ``build`` connects the rooms."""
