"""Pictures of what the pipeline sees and how well it does."""
