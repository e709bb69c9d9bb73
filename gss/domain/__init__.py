"""Basic types shared by all packages: angles, rotations, frames, cameras, stars, results. Depends on numpy, scipy
and the standard library only."""
