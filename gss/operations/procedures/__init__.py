"""Procedures: Markdown files with steps. They are checked, run by operators, and recorded."""
