"""The agent as a node of a ROS graph: sensors in, `/tf`, odometry and diagnostics out. docs/ros.md.

Nothing here needs a ROS installation to be imported: what a graph is reached through (`dds`, `rclpy_graph`, `rospy_graph`)
is imported when it is opened.
"""
