"""One file per system: its stages, its order, its limits."""
