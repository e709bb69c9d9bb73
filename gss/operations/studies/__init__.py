"""Computations on many frames, run as jobs: calibrations, night analyses, experiments, reprocessing."""
