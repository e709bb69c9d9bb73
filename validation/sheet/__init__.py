"""Proof of the performance sheet: errors injected into rendered frames."""
