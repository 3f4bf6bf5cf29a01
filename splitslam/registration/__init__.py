"""Scan-to-map registration (equation 3) against a voxel map of lines and planes; what both sides share of it."""
