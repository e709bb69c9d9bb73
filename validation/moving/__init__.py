"""Moving objects: detect satellites that were rendered into simulated frames."""
