"""Where a target is that two observers see among the stars."""
