"""`splitslam diagnose`: one file that says how a robot is, for people who were not there."""
