"""Commands from draft to report: authority, stacks, schedule, history."""
