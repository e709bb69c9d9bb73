"""Parsing of untrusted files in child processes with limits on memory, processor time and elapsed time.

:mod:`parse_processes` runs in the parent, :mod:`parse_worker` is the program of the child, and :mod:`plain_data` is the
format of returned results.
"""
