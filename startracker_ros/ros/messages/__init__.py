"""ROS messages from NumPy arrays and stage results, and back; one module for each kind."""
