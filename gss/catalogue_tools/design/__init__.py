"""Camera design: what a real or planned camera detects, and how accurately it determines its attitude.

The functions have no side effects. Angles are in radians, light in electrons, brightness in magnitudes V.
"""
