"""Procedures: Markdown files of steps that are checked, run by people, and recorded."""
