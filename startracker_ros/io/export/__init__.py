"""Recorded attitudes, tracks and diagnostics in the formats of others."""
