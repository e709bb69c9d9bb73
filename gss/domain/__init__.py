"""The words everyone uses: angles, rotations, frames, cameras, stars, results. numpy and the standard library only."""
