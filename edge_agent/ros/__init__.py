"""The agent as a node of a ROS graph: sensors in, `/tf`, odometry and diagnostics out. docs/ros.md.

Nothing here needs a ROS installation to be imported: the ways into a graph (`dds.graph`, `rclpy_graph`, `rospy_graph`)
are imported when it is joined.
"""
