"""Search for false attitudes: random pointings with faults, judged for every chain."""
