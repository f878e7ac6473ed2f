"""The attitude in a control loop: Basilisk's spacecraft and flight software around ours."""
