"""`splitslam bench load`: how many robots one map service on this machine answers in time, and what one costs."""
