"""The part of the sky that a camera can see: orbits, pointing laws, occultation."""
