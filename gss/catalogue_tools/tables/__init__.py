"""What a matcher looks up: distances, indices, triplets, links."""
