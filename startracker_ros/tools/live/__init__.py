"""A camera, the nodes and a page that shows the sky."""
