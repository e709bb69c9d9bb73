"""Experiments of Erlank's document."""
