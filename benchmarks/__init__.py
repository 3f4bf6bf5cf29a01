"""What is measured and compared; nothing of it is installed."""
