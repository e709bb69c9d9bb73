"""Long computations on many frames: calibrations, night analyses, experiments, reprocessing."""
