"""`splitslam top`: edge agents and map services live in a terminal, from their /metrics pages."""
