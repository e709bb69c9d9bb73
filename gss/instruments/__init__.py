"""Instruments as data: packages of YAML files, their models, the dictionary of the interface, and the registry."""
