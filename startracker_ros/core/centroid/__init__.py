"""Star image to centroids: background, detection, fit and what to reject."""
