"""Simulated star tracker for training; runs as a separate process on a pseudo-terminal or a TCP port."""
