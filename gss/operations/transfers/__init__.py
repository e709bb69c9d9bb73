"""File transfers in both directions, and the content of the sensor's flash banks."""
