"""Camera calibration from its own frames: geometry, photometry, detector. Start with ``self_calibrate``."""
