"""Star tables shared by ground tools and on-board chains: star pairs, k-vector, triplets, neighbour links, and the
decoded content of a bank."""
