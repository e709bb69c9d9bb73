"""Search for false attitudes: score every chain on random pointings with faults."""
