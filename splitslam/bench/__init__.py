"""`splitslam bench`: the paper's experiments on recordings, by measurement."""
