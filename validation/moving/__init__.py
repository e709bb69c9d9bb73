"""Moving objects: satellites rendered into simulated frames and found again."""
