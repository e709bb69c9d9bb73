"""Experiments of the shipped units."""
