"""Long work on many frames: calibrations, night analyses, experiments, reprocessing."""
