"""What is wrong with a robot file, found in the data: pure analysis (records in, findings out) and a command."""
