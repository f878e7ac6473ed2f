"""Image files, videos, cameras, and camera files."""
