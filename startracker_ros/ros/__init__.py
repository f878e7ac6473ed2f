"""The only package that imports rclpy: nodes, messages, parameters, processes."""
