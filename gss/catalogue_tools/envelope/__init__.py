"""Which sky will be seen: orbits, pointing laws, what stands in the way."""
