"""Campaigns: the published tables repeated, the paper's figure beside ours."""
