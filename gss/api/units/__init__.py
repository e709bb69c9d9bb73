"""Several units on one server: one process per unit, and the front process that reaches them."""
