"""Star identification: matching of centroids with catalogue stars."""
