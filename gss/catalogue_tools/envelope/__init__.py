"""The part of the sky a camera will see: orbits, pointing laws, occultation."""
