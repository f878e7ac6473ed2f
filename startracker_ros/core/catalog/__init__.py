"""The Hipparcos star catalogue, and the on-board catalogue of a camera."""
