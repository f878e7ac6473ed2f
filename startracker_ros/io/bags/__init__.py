"""Bags: MCAP files and folders as rosbag2 (Jazzy) writes them."""
