"""Star identification: matching centroids with catalogue stars."""
