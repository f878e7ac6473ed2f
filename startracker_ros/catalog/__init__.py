"""The star catalogue: Hipparcos stars, their places, and the sky as a camera sees it."""
