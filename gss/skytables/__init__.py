"""Tables of the sky that ground tools and on-board chains share: pairs of stars, k-vector, triplets, neighbour links, and
the decoded content of a bank."""
