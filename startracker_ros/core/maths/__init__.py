"""Rotations and small linear algebra, below everything else."""
