"""The engineer's part: what a camera, built or only thought of, would see and how well it would know where it points.

Pure, like the rest of the catalogue tools: angles in radians, light in electrons, brightness in magnitudes V.
"""
