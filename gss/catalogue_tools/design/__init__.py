"""Camera design: what a real or planned camera detects, and how accurately it determines its attitude.

No side effects, like the other catalogue tools: angles in radians, light in electrons, brightness in magnitudes V.
"""
