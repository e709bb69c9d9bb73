"""The catalogue manager's work: preview, build, keep, report, design."""
