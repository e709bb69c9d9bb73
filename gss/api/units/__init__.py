"""Several units on one server: one process per unit, and a front process that forwards requests to them."""
