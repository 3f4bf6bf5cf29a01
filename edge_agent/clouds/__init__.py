"""`uplink.dense: idle`: whole scans of keyframes, kept on the robot's disk and sent when the link is idle."""
