"""Which stars go on board, and how well they serve."""
