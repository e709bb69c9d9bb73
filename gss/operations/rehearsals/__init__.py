"""Rehearsals: a pass plan carried out on a simulated unit, in a separate process with a separate store, faster than real time."""
