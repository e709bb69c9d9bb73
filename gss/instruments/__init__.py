"""Instruments as data: packages of YAML files, the models of these files, the interface dictionary, and the
registry."""
