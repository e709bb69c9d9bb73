"""Parses untrusted files in child processes with limits on memory, processor time and wall time.

:mod:`parse_processes` is the parent's side, :mod:`parse_worker` the child's program, and :mod:`plain_data` the format of
returned results.
"""
