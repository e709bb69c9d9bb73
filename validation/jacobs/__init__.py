"""Experiments of Jacobs's document."""
