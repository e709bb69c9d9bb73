"""Untrusted files are parsed in child processes with limits of memory, processor time and wall time.

:mod:`parse_processes` is the parent's side, :mod:`parse_worker` the program of the child, and :mod:`plain_data` the format in
which results return.
"""
