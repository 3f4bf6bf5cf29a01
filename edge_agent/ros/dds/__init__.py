"""ROS 2 through CycloneDDS: the only package here that needs the extra `ros2`."""
