"""`splitslam run`: a recording through an edge agent and a map service, each a process of its own."""
