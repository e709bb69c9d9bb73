"""Calibration of a camera from its frames: geometry, photometry and detector. The main module is ``self_calibrate``."""
