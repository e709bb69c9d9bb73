"""Processing chains, one module per system: its stages, their order and its limits."""
