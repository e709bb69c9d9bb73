"""Experiments of Moniteq's report."""
