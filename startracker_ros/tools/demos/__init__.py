"""Demos: nodes as processes on the simulated sky, a bag, a picture, a verdict."""
