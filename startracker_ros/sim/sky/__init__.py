"""The simulated sky: motion, orbit, stars in view, detector and gyro."""
