"""Experiments of Liebe's papers."""
