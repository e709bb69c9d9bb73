"""Look-up tables for matchers: distances, indices, triplets, links."""
