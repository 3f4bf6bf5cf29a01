"""`splitslam export`: maps, trajectories, pose graphs and occupancy grids in formats that others read."""
