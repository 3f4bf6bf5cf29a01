"""A 2-D occupancy grid out of keyframes: what stands between two heights above the ground, and what is free."""
