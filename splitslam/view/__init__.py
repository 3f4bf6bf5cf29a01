"""`splitslam view`: maps, trajectories and what goes over the link, live or of a finished run, in Rerun."""
