"""Commands of `startracker` that measure."""
