"""Made places, one function each."""
