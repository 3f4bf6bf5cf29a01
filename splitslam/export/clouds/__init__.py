"""One module a point cloud format: each writes pieces of a map while they arrive."""
