"""Processing chains, one per system: stages, order of the stages, and limits."""
