"""Rehearsals of pass plans on a simulated unit, in a separate process with a separate store, faster than real time."""
