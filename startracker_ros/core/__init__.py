"""The star tracker: no ROS, no files of users, no command line."""
