"""Short-range LiDAR odometry on the robot, for the time that the map service does not answer."""
